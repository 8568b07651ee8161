"""Do the same work on a Ray cluster of two hosts and on one machine, and compare digests; kill processes and hosts.

study       a study of a thousand plans: on this machine, on one host, on two hosts, and with kills
driver      a process that gave work to the cluster is killed: the work must end as well
concurrent  two runs of one job at the same time
chain       the smoke chain with its steps as jobs of the cluster: data, members, ensemble, motions, executions
costs       time and size of an augmented image, for docs/scaling.md
"""

import argparse
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
from deltasafe.io.storage import digest_of, read_json
from deltasafe.presets import VARIABLE
from deltasafe.studies.planner import ComparisonSettings, n_plans, run_comparison
from evidence.reporting import command_parser, finish
from evidence.scale.checks import augmentation_costs, chain_digests, check_both_ran, megabytes, study_digest
from evidence.scale.local_cluster import LocalCluster, enter_namespaces
from pipelines.executors import ADDRESS, EXECUTOR, STEPS
from pipelines.home import PROJECT, set_quiet_environment

PARTS = ("study", "driver", "concurrent", "chain", "costs")
MUST_HOLD = ("digests_equal", "killed_worker_completed", "killed_driver_left_nothing", "concurrent_runs_both_ran")
N_HOSTS = 2
TIMEOUT_S = 300.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m evidence.scale``."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = command_parser("scale", __doc__)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="default: all")
    parser.add_argument("--runs", type=int, default=6, help="per method, scene and level (default 6: 1064 plans)")
    parser.add_argument("--iterations", type=int, default=5000, help="per plan (default 5000)")
    parser.add_argument("--steps", choices=("local", "ray"), default="ray", help="chain: where steps run (default ray)")
    options = parser.parse_args(given)
    set_quiet_environment()
    # one thread per process, because the order of floating-point sums depends on the number of threads
    os.environ.update({"OMP_NUM_THREADS": "1", VARIABLE: "smoke"})
    try:
        if set(options.parts) == {"costs"}:
            figures = augmentation_costs()
        else:
            enter_namespaces("evidence.scale", given)
            figures = _measure(options)
    except DeltasafeError as error:
        print(f"scale: {error}", file=sys.stderr)
        return 1
    return _record(options, figures)


def _measure(options: argparse.Namespace) -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="deltasafe-scale-") as name:
        jobs = "concurrent" in options.parts or ("chain" in options.parts and options.steps == "ray")
        with LocalCluster(jobs) as cluster:
            try:
                return _measure_on(cluster, options, pathlib.Path(name))
            finally:
                RayExecutor().disconnect()  # Ray ends a process whose cluster is gone


def _measure_on(cluster: LocalCluster, options: argparse.Namespace, folder: pathlib.Path) -> dict[str, float]:
    figures: dict[str, float] = {"workers": N_HOSTS}
    equal: list[bool] = []
    study = Study(options.runs, options.iterations, folder, cluster)
    cluster.add_host()
    if "study" in options.parts:
        found, same = study.compare_hosts()
        figures |= found
        equal.append(same)
    else:
        cluster.add_host()
    if "driver" in options.parts:
        figures["killed_driver_left_nothing"] = _kill_driver(cluster)
    if "concurrent" in options.parts:
        figures["concurrent_runs_both_ran"] = _run_concurrently(folder / "concurrent", cluster)
    if "chain" in options.parts:
        found, same = _compare_chains(folder, cluster, options.steps)
        figures |= found
        equal.append(same)
    if "costs" in options.parts:
        figures |= augmentation_costs()
    if "study" in options.parts:  # last, because it leaves one host
        figures["killed_worker_completed"] = study.survives_kills()
    if equal:
        figures["digests_equal"] = all(equal)
    return {name: float(value) for name, value in figures.items()}


class Study:
    """A planner study that runs on this machine and on the cluster."""

    def __init__(self, n_runs: int, n_iterations: int, folder: pathlib.Path, cluster: LocalCluster) -> None:
        self.settings = ComparisonSettings(n_levels=14, n_runs=n_runs, n_runs_reference=2, n_iterations=n_iterations)
        self.n_plans = n_plans(self.settings)
        self.folder, self.cluster = folder, cluster

    def compare_hosts(self) -> tuple[dict[str, float], bool]:
        """Run on this machine, on one host and on two; return figures and whether the digests are equal."""
        executor = RayExecutor(RaySettings(self.cluster.address))
        local, _ = self._run("local", LOCAL)
        self._warm_up("warm-1", executor)
        one, one_s = self._run("one-host", executor)
        self.cluster.add_host()
        deadline = time.monotonic() + TIMEOUT_S
        while executor.n_parallel(1) < N_HOSTS and time.monotonic() < deadline:
            time.sleep(0.2)
        self._warm_up("warm-2", executor)
        two, two_s = self._run("two-hosts", executor)
        figures = {
            "plans": self.n_plans,
            "speedup": round(one_s / two_s, 3),
            "one_host_s": round(one_s, 2),
            "two_hosts_s": round(two_s, 2),
        }
        return figures, local == one == two

    def survives_kills(self) -> bool:
        """Kill a worker process in the first half of the study and then a host; tell whether the plans are the same."""
        executor, left = RayExecutor(RaySettings(self.cluster.address)), ["process", "host"]

        def kill(done: int, total: int, message: str) -> None:
            if "process" in left and 0 < done < total / 2 and self.cluster.kill_a_worker():
                left.remove("process")
            if "host" in left and done >= total / 2:
                self.cluster.kill_host(N_HOSTS - 1)
                left.remove("host")
                print(f"  a host was killed after {done} of {total} batches", flush=True)

        digest, _ = self._run("killed", executor, kill)
        local, _ = self._run("local", LOCAL)  # reads the stored batches
        return digest == local and not left

    def _run(self, name: str, executor: Executor, progress: Progress = silent) -> tuple[str, float]:
        began_s = time.monotonic()
        digest = study_digest(run_comparison(self.settings, self.folder / name, 1, progress, executor))
        took_s = time.monotonic() - began_s
        print(f"  {self.n_plans} plans, {name}: {took_s:.1f} s, digest {digest[:16]}", flush=True)
        return digest, took_s

    def _warm_up(self, name: str, executor: RayExecutor) -> None:
        """Let every worker load and compile what it needs."""
        few = dataclasses.replace(self.settings, n_levels=2 * N_HOSTS, n_runs=2, n_runs_reference=2, n_iterations=50)
        run_comparison(few, self.folder / name, 1, silent, executor)


def _kill_driver(cluster: LocalCluster) -> bool:
    """Kill a process that gave work to the cluster; tell whether the work ended."""
    program = (
        "import time; from deltasafe.compute.executor import Task; "
        "from deltasafe.compute.ray_executor import RayExecutor, RaySettings; "
        f"list(RayExecutor(RaySettings('{cluster.address}')).run([Task('sleep', time.sleep, (3600.0,))], 1))"
    )
    driver = subprocess.Popen([sys.executable, "-c", program], cwd=PROJECT)
    deadline = time.monotonic() + TIMEOUT_S
    while not (before := cluster.busy_pids()) and driver.poll() is None and time.monotonic() < deadline:
        time.sleep(0.2)
    driver.kill()
    driver.wait()
    while (after := cluster.busy_pids()) and time.monotonic() < deadline:
        time.sleep(0.2)
    print(f"  killed driver: {len(before)} busy workers before, {len(after)} after", flush=True)
    return bool(before) and not after


def _on_cluster(cluster: LocalCluster, home: pathlib.Path, steps: str) -> dict[str, str]:
    chosen = {EXECUTOR: "ray", ADDRESS: cluster.address, STEPS: steps}
    return {**os.environ, **chosen, "DELTASAFE_HOME": str(home)}


def _run_concurrently(home: pathlib.Path, cluster: LocalCluster) -> bool:
    """Run the planner study twice at the same time in one home; tell whether both ran."""
    environment = _on_cluster(cluster, home, "ray")
    command = [
        sys.executable,
        "-c",
        "import sys; from evidence.scale import checks; sys.exit(checks.run(sys.argv[1:]))",
    ]
    subprocess.run([*command, "prepare"], cwd=PROJECT, env=environment, check=True)
    runs = [subprocess.Popen([*command, str(seed)], cwd=PROJECT, env=environment) for seed in (0, 1000)]
    statuses = [run.wait() for run in runs]
    holds, lines = check_both_ran(home)
    for line in lines:
        print(f"  {line}", flush=True)
    return statuses == [0, 0] and holds


def _compare_chains(folder: pathlib.Path, cluster: LocalCluster, steps: str) -> tuple[dict[str, float], bool]:
    """Run the smoke chain on the cluster and on this machine; return figures and whether the digests are equal."""
    digests: list[dict[str, str]] = []
    figures: dict[str, float] = {}
    for name in ("cluster", "single"):
        home = folder / f"chain-{name}"
        local = {**os.environ, "DELTASAFE_HOME": str(home)}
        environment = _on_cluster(cluster, home, steps) if name == "cluster" else local
        began_s = time.monotonic()
        command = [sys.executable, "-m", "pipelines.commands.demo"]
        run = subprocess.run(command, cwd=PROJECT, env=environment, stderr=subprocess.PIPE, check=False)
        if run.returncode:
            sys.stderr.write(run.stderr.decode(errors="replace")[-4000:])
            return figures, False
        digests.append(chain_digests(home))
        figures[f"chain_{name}_s"] = round(time.monotonic() - began_s, 1)
        figures |= {f"chain_{what}_mb": round(megabytes(home / what), 2) for what in ("dagster", "mlflow")}
        print(f"  smoke chain, {name}: {figures[f'chain_{name}_s']:.0f} s, {digest_of(digests[-1])[:16]}", flush=True)
    different = [name for name in digests[0] if digests[0][name] != digests[1].get(name)]
    print(f"  {len(digests[0])} artifacts, {len(different)} of them differ: {', '.join(different)}", flush=True)
    return figures, digests[0] == digests[1]


def _record(options: argparse.Namespace, figures: dict[str, float]) -> int:
    """Record the figures; all parts together replace the record, single parts are merged into it."""
    name = " ".join(options.parts)
    command = f"python -m evidence.scale --parts {name} --steps {options.steps}"
    failures = [f"{figure} does not hold" for figure in MUST_HOLD if not figures.get(figure, 1)]
    if options.record and set(options.parts) == set(PARTS):
        options.record.unlink(missing_ok=True)
        name, command = "scale", "make scale"
    if options.record and options.record.is_file() and "digests_equal" in figures:
        earlier = read_json(options.record)["parts"]
        others = [part["figures"].get("digests_equal", 1.0) for other, part in earlier.items() if other != name]
        figures = figures | {"digests_equal": min(figures["digests_equal"], *others, 1.0)}
    return finish(
        options,
        figures,
        failures,
        part=name,
        command=command,
        seeds={"plans_from": 0},
        hosts="network namespaces on one machine, one core each",
        iterations=options.iterations,
        steps_of_the_chain=options.steps,
    )


if __name__ == "__main__":
    sys.exit(main())
