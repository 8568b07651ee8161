"""`make examples`: the ensemble in use, pulled in three ways into environments made from the built wheel."""

import argparse
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
from deltasafe.perception.artifact import verify_artifact
from deltasafe.storage import write_json
from evidence.consumer_environments import EXAMPLES, ConsumerEnvironment, built_wheel
from pipelines.home import DATASETS, PROJECT, TRACKING_VARIABLE, prepare_home, tracking_uri
from pipelines.registry import EnsembleRegistry
from pipelines.tracking import MlflowTracker

__all__ = ["TOLERANCE", "WAYS", "Outcome", "main"]

TOLERANCE = 1e-4
"""In probability, between any way and the first one."""

TORCH = ConsumerEnvironment("torch", lacks=("dagster", "mlflow"))
ONNX = ConsumerEnvironment("onnx", lacks=("deltasafe", "torch", "dagster", "mlflow"))
REGISTRY = ConsumerEnvironment("registry", lacks=("dagster",), on_top_of=TORCH)

WAYS = {"from_folder": TORCH, "with_onnxruntime": ONNX, "from_registry": REGISTRY}
PLAN = "plan_around_a_hand"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one script.

    Attributes:
        complaint: why it did not pass; empty if it did.
        seconds: of the whole process, imports and verification included.
        max_difference: of the probability image to that of the first way.
        printed: by the script.
    """

    complaint: str
    seconds: float
    max_difference: float | None
    printed: str


def main(arguments: list[str] | None = None) -> int:
    """0 if all ways passed and a motion was planned."""
    parser = argparse.ArgumentParser(prog="python -m evidence.consumers", description=__doc__)
    parser.add_argument("--ensemble", type=pathlib.Path, metavar="DIR", help="a frozen ensemble; the one in use")
    parser.add_argument("--scene", type=pathlib.Path, metavar="DIR", default=DATASETS / "scenes" / "scene_000")
    parser.add_argument("--torch-index", default="", help="another index for torch's build")
    parser.add_argument("--record", type=pathlib.Path, help="also merge the figures into this file (docs/results/...)")
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
    _print_summary(outcomes)
    figures = figures_of(outcomes)
    write_json(out / "examples.json", {"ensemble": ensemble.name, "figures": figures, "scripts": outcomes})
    if options.record:
        from pipelines.records import merge_part

        merge_part(
            options.record,
            "examples",
            figures,
            command="make examples",
            seeds={"plan": 0},
            ensemble=ensemble.name,
            wheel=wheel.name,
        )
    return 0 if all(not outcome.complaint for outcome in outcomes.values()) else 1


def run_all(ensemble: pathlib.Path, registry: str, scene: pathlib.Path, out: pathlib.Path) -> dict[str, Outcome]:
    """Each script in its environment, one after another; by name."""
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
        if not outcome.complaint:
            difference = _largest_difference(reference, found)
            far = "" if difference <= TOLERANCE else f"differs from from_folder by {difference:.2g}"
            outcome = dataclasses.replace(outcome, complaint=far, max_difference=difference)
        outcomes[name] = outcome
    outcomes[PLAN] = _run(PLAN, TORCH, [str(ensemble), str(scene), "-o", str(out / "plan")])
    return outcomes


def figures_of(outcomes: dict[str, Outcome]) -> dict[str, float]:
    """`consumer_ways` that passed, how far they are apart at most, seconds of each script."""
    passed = [name for name in WAYS if not outcomes[name].complaint]
    differences = [outcome.max_difference for outcome in outcomes.values() if outcome.max_difference is not None]
    seconds = {f"consumer_seconds_{name}": round(outcome.seconds, 1) for name, outcome in outcomes.items()}
    return {
        "consumer_ways": len(passed),
        "consumer_plan_passed": float(not outcomes[PLAN].complaint),
        **({"consumer_max_difference": max(differences)} if differences else {}),
        **seconds,
    }


def _run(name: str, environment: ConsumerEnvironment, arguments: list[str]) -> Outcome:
    if intruders := environment.intruders():
        return Outcome(f"importable in {environment.folder.name}: {', '.join(intruders)}", 0.0, None, "")
    began_s = time.monotonic()
    done = environment.run(str(EXAMPLES / f"{name}.py"), *arguments)
    seconds = time.monotonic() - began_s
    complaint = "" if done.returncode == 0 else (done.stderr.strip() or f"exit status {done.returncode}")
    return Outcome(complaint, seconds, None, done.stdout)


def _largest_difference(reference: pathlib.Path, found: pathlib.Path) -> float:
    if not reference.is_file():
        return float("inf")
    expected, given = (np.load(file, allow_pickle=False) for file in (reference, found))
    return float(np.abs(expected - given).max()) if expected.shape == given.shape else float("inf")


@contextlib.contextmanager
def _ensemble_and_registry(given: pathlib.Path | None) -> Iterator[tuple[pathlib.Path, str]]:
    """The ensemble in use and its registry; or the one given, and a registry of its own with it as champion."""
    if given is None:
        root = prepare_home()
        ensemble = EnsembleRegistry(MlflowTracker(root)).champion()
        if ensemble is None:
            raise DeltasafeError(f"{root} has no ensemble in use; `make demo` makes one, ENSEMBLE=DIR takes another")
        yield ensemble, tracking_uri(root)
        return
    ensemble = given.expanduser().resolve()
    verify_artifact(ensemble)
    os.environ.pop(TRACKING_VARIABLE, None)  # nothing is registered on a server for an example
    with tempfile.TemporaryDirectory() as temporary:
        tracker = MlflowTracker(pathlib.Path(temporary))
        tracker.register("examples", ensemble)
        tracker.call("promote", artifact=ensemble.name, because="of an example")
        yield ensemble, tracking_uri(tracker.home)


def _print_summary(outcomes: dict[str, Outcome]) -> None:
    for name, outcome in outcomes.items():
        print(f"\n{name}: {'FAILED: ' + outcome.complaint if outcome.complaint else 'passed'}, {outcome.seconds:.1f} s")
        for line in outcome.printed.splitlines():
            print(f"  {line}")
        if outcome.max_difference:
            print(f"  within {outcome.max_difference:.0e} of from_folder")
    passed = sum(not outcomes[name].complaint for name in WAYS)
    print(f"\n{passed} of {len(WAYS)} ways passed; probability images and the plan are in {EXAMPLES / 'out'}")


if __name__ == "__main__":
    sys.exit(main())
