"""`make scale`: the same work on a Ray cluster of two hosts and on one machine. Same results? And what if a host dies?

chain       the smoke chain, its steps as jobs of the cluster: augmented set, members, ensemble, motions, executions
study       a study of a thousand plans: here, on one host, on two, and on two of which one is killed
driver      a process that has given work to the cluster and is killed: the work ends as well
concurrent  two runs of one job at the same time
costs       of an augmented image, which no other record has; for docs/explanation/scale.md
"""

import argparse
import contextlib
import dataclasses
import os
import pathlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.compute.ray_executor import RayExecutor, RaySettings
from deltasafe.errors import DeltasafeError
from deltasafe.io.storage import digest_of, read_json, write_json
from deltasafe.presets import VARIABLE
from deltasafe.studies.planner import ComparisonSettings, n_plans, run_comparison
from pipelines.executors import ADDRESS, EXECUTOR, STEPS
from pipelines.home import PROJECT, set_quiet_environment
from pipelines.local_cluster import LocalCluster, apart
from pipelines.scale_evidence import augmentation_costs, both_ran, chain_digests, megabytes, study_digest

__all__ = ["main"]

PARTS = ("study", "driver", "concurrent", "chain", "costs")
_HOSTS = 2
_PATIENCE_S = 300.0


def main(arguments: Sequence[str] | None = None) -> int:
    """0 if everything that was asked for held."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = argparse.ArgumentParser(
        prog="python -m pipelines.scale", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="all of them by default")
    parser.add_argument("--runs", type=int, default=6, help="of a method, scene and level: 6 make 1064 plans")
    parser.add_argument("--iterations", type=int, default=5000, help="of a plan (default 5000)")
    parser.add_argument("--steps", choices=("local", "ray"), default="ray", help="chain: where its steps are (ray)")
    parser.add_argument("--record", type=pathlib.Path, help="also merge the figures into this file (docs/results/...)")
    parser.add_argument("--out", type=pathlib.Path, help="also write the figures to this file, and nothing else")
    options = parser.parse_args(given)
    set_quiet_environment()
    # sums over several threads are other sums: one a process, here as there
    os.environ.update({"OMP_NUM_THREADS": "1", VARIABLE: "smoke"})
    try:
        if set(options.parts) == {"costs"}:
            figures = _costs()
        else:
            apart("pipelines.scale", given)
            figures = _measured(options)
    except DeltasafeError as error:
        print(f"scale: {error}", file=sys.stderr)
        return 1
    for name, value in figures.items():
        print(f"  {name:30s} {value:g}")
    if options.out:
        write_json(options.out, figures)
    if options.record:
        _record(options, figures)
    return 0 if all(figures.get(name, 1) for name in _HELD) else 1


_HELD = ("digests_equal", "killed_worker_completed", "killed_driver_left_nothing", "concurrent_runs_both_ran")


def _measured(options: argparse.Namespace) -> dict[str, float]:
    figures: dict[str, float] = {"workers": _HOSTS}
    same: list[bool] = []
    jobs = "concurrent" in options.parts or ("chain" in options.parts and options.steps == "ray")
    disconnect = RayExecutor().disconnect
    with (
        tempfile.TemporaryDirectory(prefix="deltasafe-scale-") as name,
        LocalCluster(jobs) as cluster,
        contextlib.ExitStack() as first,
    ):
        first.callback(disconnect)  # Ray ends a process whose cluster is gone
        folder = pathlib.Path(name)
        cluster.add_host()
        if "study" in options.parts:
            settings = ComparisonSettings(
                n_levels=14, n_runs=options.runs, n_runs_beside=2, n_iterations=options.iterations
            )
            found, alike = _study(settings, folder, cluster)
            figures |= found
            same.append(alike)
        else:
            cluster.add_host()
        if "driver" in options.parts:
            figures["killed_driver_left_nothing"] = _driver(cluster)
        if "concurrent" in options.parts:
            figures["concurrent_runs_both_ran"] = _concurrent(folder / "concurrent", cluster)
        if "chain" in options.parts:
            found, alike = _chain(folder, cluster, options.steps)
            figures |= found
            same.append(alike)
        if "costs" in options.parts:
            figures |= _costs()
        if "study" in options.parts:  # last, since it leaves one host
            figures["killed_worker_completed"] = _killed(settings, folder, cluster)
    if same:
        figures["digests_equal"] = all(same)
    return {name: float(value) for name, value in figures.items()}


def _costs() -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="deltasafe-scale-") as name:
        return augmentation_costs(pathlib.Path(name))


def _study(settings: ComparisonSettings, folder: pathlib.Path, cluster: LocalCluster) -> tuple[dict[str, float], bool]:
    executor = RayExecutor(RaySettings(cluster.address))
    here, _ = _timed("here", settings, folder, LOCAL)
    _warm(settings, folder / "warm-1", executor)
    one, alone_s = _timed("one host", settings, folder, executor)
    cluster.add_host()
    _wait_for_hosts(executor)
    _warm(settings, folder / "warm-2", executor)
    two, together_s = _timed("two hosts", settings, folder, executor)
    print(f"  speed-up of two hosts over one: {alone_s / together_s:.2f}", flush=True)
    figures = {
        "plans": n_plans(settings),
        "speedup": round(alone_s / together_s, 3),
        "one_host_s": round(alone_s, 2),
        "two_hosts_s": round(together_s, 2),
    }
    return figures, here == one == two


def _killed(settings: ComparisonSettings, folder: pathlib.Path, cluster: LocalCluster) -> bool:
    """A process of a task in the first third of the study, and all processes of a host after the half."""
    executor, left = RayExecutor(RaySettings(cluster.address)), ["a process", "a host"]

    def strike(done: int, total: int, message: str) -> None:
        if "a process" in left and 0 < done < total / 2 and cluster.kill_a_worker():
            left.remove("a process")
        if "a host" in left and done >= total / 2:
            cluster.kill_host(_HOSTS - 1)
            left.remove("a host")
            print(f"  a host was killed after {done} of {total} batches", flush=True)

    digest, _ = _timed("killed", settings, folder, executor, strike)
    here, _ = _timed("here", settings, folder, LOCAL)  # is found
    return digest == here and not left


def _timed(
    name: str, settings: ComparisonSettings, folder: pathlib.Path, executor: Executor, progress: Progress = silent
) -> tuple[str, float]:
    began_s = time.monotonic()
    digest = study_digest(run_comparison(settings, folder / name.replace(" ", "-"), 1, progress, executor))
    took_s = time.monotonic() - began_s
    print(f"  {n_plans(settings)} plans, {name}: {took_s:.1f} s, digest {digest[:16]}", flush=True)
    return digest, took_s


def _warm(settings: ComparisonSettings, folder: pathlib.Path, executor: Executor) -> None:
    """Every worker has loaded and compiled what it needs."""
    few = dataclasses.replace(settings, n_levels=2 * _HOSTS, n_runs=2, n_runs_beside=2, n_iterations=50)
    run_comparison(few, folder, 1, silent, executor)


def _wait_for_hosts(executor: RayExecutor) -> None:
    until_s = time.monotonic() + _PATIENCE_S
    while executor.width(1) < _HOSTS and time.monotonic() < until_s:
        time.sleep(0.2)


def _driver(cluster: LocalCluster) -> bool:
    program = (
        "import time; from deltasafe.compute.executor import Task; from deltasafe.compute.ray_executor import RayExecutor, RaySettings; "
        f"list(RayExecutor(RaySettings('{cluster.address}')).run([Task('sleep', time.sleep, (3600.0,))], 1))"
    )
    driver = subprocess.Popen([sys.executable, "-c", program], cwd=PROJECT)
    until_s = time.monotonic() + _PATIENCE_S
    while not (busy := cluster.at_work()) and driver.poll() is None and time.monotonic() < until_s:
        time.sleep(0.2)
    driver.kill()
    driver.wait()
    while cluster.at_work() and time.monotonic() < until_s:
        time.sleep(0.2)
    print(f"  a killed driver: {len(busy)} at work before, {len(cluster.at_work())} after", flush=True)
    return bool(busy) and not cluster.at_work()


def _on_the_cluster(cluster: LocalCluster, home: pathlib.Path) -> dict[str, str]:
    chosen = {EXECUTOR: "ray", ADDRESS: cluster.address, STEPS: "ray"}
    return {**os.environ, **chosen, "DELTASAFE_HOME": str(home)}


def _concurrent(home: pathlib.Path, cluster: LocalCluster) -> bool:
    environment = _on_the_cluster(cluster, home)
    program = "import sys; from pipelines.scale_evidence import run_study; sys.exit(run_study(int(sys.argv[1])))"
    subprocess.run(
        [
            sys.executable,
            "-c",
            "from pipelines.home import prepare_home; prepare_home(); "
            "import dagster as dg; dg.DagsterInstance.get().dispose()",
        ],
        cwd=PROJECT,
        env=environment,
        check=True,
    )
    command = [sys.executable, "-c", program]
    runs = [subprocess.Popen([*command, str(seed)], cwd=PROJECT, env=environment) for seed in (0, 1000)]
    ended = [run.wait() for run in runs]
    evidence = both_ran(home)
    for line in evidence.lines:
        print(f"  {line}", flush=True)
    return ended == [0, 0] and evidence.holds


def _chain(folder: pathlib.Path, cluster: LocalCluster, steps: str) -> tuple[dict[str, float], bool]:
    made: list[dict[str, str]] = []
    figures: dict[str, float] = {}
    for name in ("cluster", "single"):
        home = folder / f"chain-{name}"
        alone = {**os.environ, "DELTASAFE_HOME": str(home)}
        environment = _on_the_cluster(cluster, home) | {STEPS: steps} if name == "cluster" else alone
        began_s = time.monotonic()
        said = subprocess.run(
            [sys.executable, "-m", "pipelines.commands.demo"],
            cwd=PROJECT,
            env=environment,
            stderr=subprocess.PIPE,
            check=False,
        )
        if said.returncode:
            sys.stderr.write(said.stderr.decode(errors="replace")[-4000:])
            return figures, False
        made.append(chain_digests(home))
        figures[f"chain_{name}_s"] = round(time.monotonic() - began_s, 1)
        figures |= {f"chain_{what}_mb": round(megabytes(home / what), 2) for what in ("dagster", "mlflow")}
        print(f"  smoke chain, {name}: {figures[f'chain_{name}_s']:.0f} s, {digest_of(made[-1])[:16]}", flush=True)
    different = [what for what in made[0] if made[0][what] != made[1].get(what)]
    print(f"  {len(made[0])} things made, {len(different)} of them differ: {', '.join(different)}", flush=True)
    return figures, made[0] == made[1]


def _record(options: argparse.Namespace, figures: dict[str, float]) -> None:
    """Parts may be measured one by one; all of them together replace whatever was recorded."""
    from pipelines.commands.records import merge_part

    whole = set(options.parts) == set(PARTS)
    if whole:
        options.record.unlink(missing_ok=True)
    name = "scale" if whole else " ".join(options.parts)
    earlier = read_json(options.record)["parts"] if options.record.is_file() else {}
    others = [part["figures"].get("digests_equal", 1.0) for other, part in earlier.items() if other != name]
    if "digests_equal" in figures:
        figures = figures | {"digests_equal": min(figures["digests_equal"], *others, 1.0)}
    merge_part(
        options.record,
        name,
        figures,
        command="make scale" if whole else f"python -m pipelines.scale --parts {name} --steps {options.steps}",
        seeds={"plans_from": 0},
        hosts="network namespaces on one machine, one core each",
        iterations=options.iterations,
        steps_of_the_chain=options.steps,
        load_1min=round(os.getloadavg()[0], 2),
    )


if __name__ == "__main__":
    sys.exit(main())
