"""Load the ensemble in use in three ways, in environments made from the built wheel (`make examples`)."""

import contextlib
import dataclasses
import os
import pathlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

import numpy as np

from deltasafe.errors import DeltasafeError
from deltasafe.io.storage import write_json
from deltasafe.perception.artifact.frozen_ensemble import verify_artifact
from evidence.consumer_environments import EXAMPLES, ConsumerEnvironment, built_wheel
from evidence.reporting import command_parser, finish
from pipelines.home import DATASETS, PROJECT, TRACKING_VARIABLE, prepare_home, tracking_uri
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker

TOLERANCE = 1e-4
"""Largest difference of probabilities between the first way and the others."""

TORCH = ConsumerEnvironment("torch", lacks=("dagster", "mlflow"))
ONNX = ConsumerEnvironment("onnx", lacks=("deltasafe", "torch", "dagster", "mlflow"))
REGISTRY = ConsumerEnvironment("registry", lacks=("dagster",), on_top_of=TORCH)

WAYS = {"from_folder": TORCH, "with_onnxruntime": ONNX, "from_registry": REGISTRY}
PLAN = "plan_around_a_hand"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of one script.

    Attributes:
        failure: why it did not pass; empty if it did.
        seconds: of the whole process, with imports and verification.
        max_difference: of the probability image from that of the first way.
        printed: output of the script.
    """

    failure: str
    seconds: float
    max_difference: float | None
    printed: str


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.consumers``; 1 if a script did not pass."""
    parser = command_parser("consumers", __doc__)
    parser.add_argument("--ensemble", type=pathlib.Path, metavar="DIR", help="a frozen ensemble; default: in use")
    parser.add_argument("--scene", type=pathlib.Path, metavar="DIR", default=DATASETS / "scenes" / "scene_000")
    parser.add_argument("--torch-index", default="", help="package index of another build of torch")
    options = parser.parse_args(arguments)
    out = EXAMPLES / "out"
    out.mkdir(exist_ok=True)
    try:
        with _ensemble_and_registry(options.ensemble) as (ensemble, registry):
            wheel = built_wheel(PROJECT / "dist")
            for environment in (ONNX, REGISTRY):
                environment.make(wheel, options.torch_index)
            outcomes = run_all(ensemble, registry, options.scene.resolve(), out)
    except DeltasafeError as error:
        print(f"examples: {error}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as error:
        print(f"examples: {' '.join(map(str, error.cmd))} failed. {error.stderr or ''}", file=sys.stderr)
        return 1
    _print_outputs(outcomes)
    print(f"probability images and the plan are in {out}")
    figures = figures_of(outcomes)
    write_json(out / "examples.json", {"ensemble": ensemble.name, "figures": figures, "scripts": outcomes})
    return finish(
        options,
        figures,
        [f"{name}: {outcome.failure}" for name, outcome in outcomes.items() if outcome.failure],
        part="examples",
        command="make examples",
        seeds={"plan": 0},
        ensemble=ensemble.name,
        wheel=wheel.name,
    )


def run_all(ensemble: pathlib.Path, registry: str, scene: pathlib.Path, out: pathlib.Path) -> dict[str, Outcome]:
    """Run each script in its environment, in sequence; return the outcomes by name."""
    image = next(scene.glob("image.*"))
    given = {
        "from_folder": [str(ensemble), str(image)],
        "with_onnxruntime": [str(ensemble), str(image)],
        "from_registry": [str(image), "--registry", registry],
    }
    outcomes: dict[str, Outcome] = {}
    reference = out / "from_folder.npy"
    for name, environment in WAYS.items():
        found = out / f"{name}.npy"
        found.unlink(missing_ok=True)
        outcome = _run(name, environment, [*given[name], "-o", str(found)])
        if not outcome.failure:
            difference = _largest_difference(reference, found)
            failure = "" if difference <= TOLERANCE else f"differs from from_folder by {difference:.2g}"
            outcome = dataclasses.replace(outcome, failure=failure, max_difference=difference)
        outcomes[name] = outcome
    outcomes[PLAN] = _run(PLAN, TORCH, [str(ensemble), str(scene), "-o", str(out / "plan")])
    return outcomes


def figures_of(outcomes: dict[str, Outcome]) -> dict[str, float]:
    """Return the number of ways that passed, their largest difference, and the seconds of each script."""
    passed = [name for name in WAYS if not outcomes[name].failure]
    differences = [outcome.max_difference for outcome in outcomes.values() if outcome.max_difference is not None]
    seconds = {f"consumer_seconds_{name}": round(outcome.seconds, 1) for name, outcome in outcomes.items()}
    return {
        "consumer_ways": len(passed),
        "consumer_plan_passed": float(not outcomes[PLAN].failure),
        **({"consumer_max_difference": max(differences)} if differences else {}),
        **seconds,
    }


def _run(name: str, environment: ConsumerEnvironment, arguments: list[str]) -> Outcome:
    if forbidden := environment.forbidden_packages():
        return Outcome(f"importable in {environment.folder.name}: {', '.join(forbidden)}", 0.0, None, "")
    began_s = time.monotonic()
    done = environment.run(str(EXAMPLES / f"{name}.py"), *arguments)
    seconds = time.monotonic() - began_s
    failure = "" if done.returncode == 0 else (done.stderr.strip() or f"exit status {done.returncode}")
    return Outcome(failure, seconds, None, done.stdout)


def _largest_difference(reference: pathlib.Path, found: pathlib.Path) -> float:
    if not reference.is_file():
        return float("inf")
    expected, given = (np.load(file, allow_pickle=False) for file in (reference, found))
    return float(np.abs(expected - given).max()) if expected.shape == given.shape else float("inf")


@contextlib.contextmanager
def _ensemble_and_registry(given: pathlib.Path | None) -> Iterator[tuple[pathlib.Path, str]]:
    """Yield the ensemble in use and its registry, or the given one and a temporary registry with it as champion."""
    if given is None:
        root = prepare_home()
        ensemble = EnsembleRegistry(MlflowTracker(root)).champion()
        if ensemble is None:
            raise DeltasafeError(f"{root} has no ensemble in use; `make demo` makes one, ENSEMBLE=DIR names another")
        yield ensemble, tracking_uri(root)
        return
    ensemble = given.expanduser().resolve()
    verify_artifact(ensemble)
    os.environ.pop(TRACKING_VARIABLE, None)  # an example must not register anything on a server
    with tempfile.TemporaryDirectory() as temporary:
        tracker = MlflowTracker(pathlib.Path(temporary))
        tracker.register("examples", ensemble)
        tracker.call("promote", artifact=ensemble.name, because="of an example")
        yield ensemble, tracking_uri(tracker.home)


def _print_outputs(outcomes: dict[str, Outcome]) -> None:
    for name, outcome in outcomes.items():
        print(f"\n{name}: {'FAILED' if outcome.failure else 'passed'}, {outcome.seconds:.1f} s")
        for line in outcome.printed.splitlines():
            print(f"  {line}")
        if outcome.max_difference:
            print(f"  differs from from_folder by at most {outcome.max_difference:.0e}")


if __name__ == "__main__":
    sys.exit(main())
