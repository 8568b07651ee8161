"""Make an augmented set, a member, a plan and an execution from one seed in several processes, and compare digests.

Every process starts anew, with another seed of Python's string hashing, and trains with one thread: with several
threads, the order of floating-point sums is not defined.
"""

import hashlib
import json
import os
import pathlib
import subprocess
import sys

from deltasafe.compute.progress import Progress, silent
from evidence.fixtures import temporary_home, tiny_hands, tiny_set
from evidence.reporting import command_parser, finish, print_progress
from pipelines.home import PROJECT


def digests_of(seed: int, home: pathlib.Path) -> dict[str, str]:
    """Make each artifact from the seed in this process, and return the SHA-256 of each."""
    return {**_perception(seed, home), **_motion(seed)}


def _perception(seed: int, home: pathlib.Path) -> dict[str, str]:
    import torch

    from deltasafe.io.storage import sha256_of_file
    from deltasafe.perception.settings import NetworkSettings, TrainingSettings
    from deltasafe.perception.training.train_member import train_member

    torch.set_num_threads(1)
    data = tiny_set(tiny_hands(home / "hands"), home / "set", seed)
    data.verify()
    training = TrainingSettings(NetworkSettings(pretrained=False, pyramid_channels=16), epochs=2, batch_size=4)
    member = train_member(data, training, seed, home / "member", "cpu")
    return {"dataset": data.digest, "member": sha256_of_file(member.weights)}


def _motion(seed: int) -> dict[str, str]:
    from deltasafe.execution import ExecutionSettings, MonitorLimits, Workcell, execute
    from deltasafe.geometry import Pose
    from deltasafe.planning import MotionSettings, plan_motion
    from deltasafe.scene import Cuboid, grid_from_shapes

    block = Cuboid((0.0, 0.0, 0.03), (0.02, 0.05, 0.03))
    grid = grid_from_shapes([block], 0.01, (-0.2, -0.15, 0.0), (0.2, 0.15, 0.09), 0.005)
    start, goal = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, 0.5)
    motion = plan_motion(grid, start, goal, MotionSettings(n_iterations=500), seed)
    if motion.trajectory is None:
        raise RuntimeError(f"no motion was found: {motion.reason}")
    plan = hashlib.sha256()
    for array in (motion.trajectory.time_s, motion.trajectory.poses, motion.trajectory.velocities):
        plan.update(array.tobytes())
    limits = MonitorLimits.of(motion.settings)
    execution = execute(motion.trajectory, Workcell(motion.body), ExecutionSettings(), seed, limits=limits)
    return {"plan": plan.hexdigest(), "execution": execution.digest()}


def compare(seed: int, processes: int, progress: Progress = silent) -> dict[str, list[str]]:
    """Run ``processes`` processes in sequence; return the digests of each artifact, one per process."""
    found: dict[str, list[str]] = {}
    command = [sys.executable, "-m", "evidence.faults.digests", "--alone", "--seed", str(seed)]
    for number in range(1, processes + 1):
        environment = {**os.environ, "PYTHONHASHSEED": str(number), "OMP_NUM_THREADS": "1"}
        output = subprocess.run(command, cwd=PROJECT, env=environment, check=True, capture_output=True, text=True)
        for name, digest in json.loads(output.stdout.splitlines()[-1]).items():
            found.setdefault(name, []).append(digest)
        progress(number, processes, "processes")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.digests``."""
    parser = command_parser("faults.digests", __doc__, seeded=True)
    parser.add_argument("--processes", type=int, default=3, help="processes to compare (default 3)")
    parser.add_argument("--alone", action="store_true", help="print the digests of this process alone, as JSON")
    options = parser.parse_args(arguments)
    if options.alone:
        with temporary_home() as home:
            print(json.dumps(digests_of(options.seed, home)))
        return 0
    found = compare(options.seed, options.processes, print_progress(1))
    failures = [f"{name}: {digests}" for name, digests in found.items() if len({*digests}) != 1]
    figures = {"digests": len(found), "digests_differing": len(failures), "digest_processes": options.processes}
    return finish(options, figures, failures, sha256={name: digests[0] for name, digests in found.items()})


if __name__ == "__main__":
    sys.exit(main())
