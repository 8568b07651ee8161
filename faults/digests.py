"""One seed, three processes, the same bytes: an augmented set, a trained member, a plan and an execution.

The processes begin anew each time, with other seeds of Python's own hashing; each trains with one thread, since sums
over several are taken in an order of their own.
"""

import hashlib
import json
import os
import pathlib
import subprocess
import sys
import tempfile

from deltasafe.compute.progress import Progress, silent
from faults.reporting import conclude, parser, progress_every

__all__ = ["compare", "digests_of", "main"]

ROOT = pathlib.Path(__file__).parents[1]


def digests_of(seed: int, home: pathlib.Path) -> dict[str, str]:
    """SHA-256 of each kind, made from the seed in this process."""
    return {**_perception(seed, home), **_motion(seed)}


def _perception(seed: int, home: pathlib.Path) -> dict[str, str]:
    import torch

    from deltasafe.io.storage import sha256_of_file
    from deltasafe.perception.settings import NetworkSettings, TrainingSettings
    from deltasafe.perception.training.train_member import train_member
    from faults.sets import tiny_hands, tiny_set

    torch.set_num_threads(1)
    made = tiny_set(tiny_hands(home / "hands"), home / "set", seed)
    made.verify()
    training = TrainingSettings(NetworkSettings(pretrained=False, pyramid_channels=16), epochs=2, batch_size=4)
    member = train_member(made, training, seed, home / "member", "cpu")
    return {"dataset": made.digest, "member": sha256_of_file(member.weights)}


def _motion(seed: int) -> dict[str, str]:
    from deltasafe.execution import ExecutionSettings, MonitorLimits, Workcell, execute
    from deltasafe.geometry import Pose
    from deltasafe.planning import MotionSettings, plan_motion
    from deltasafe.scene import Cuboid, grid_from_shapes

    block = Cuboid((0.0, 0.0, 0.03), (0.02, 0.05, 0.03))
    field = grid_from_shapes([block], 0.01, (-0.2, -0.15, 0.0), (0.2, 0.15, 0.09), 0.005)
    ends = Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, 0.5)
    motion = plan_motion(field, *ends, MotionSettings(n_iterations=500), seed)
    if motion.trajectory is None:
        raise RuntimeError(f"no motion to take the digest of: {motion.reason}")
    planned = hashlib.sha256()
    for array in (motion.trajectory.time_s, motion.trajectory.poses, motion.trajectory.velocities):
        planned.update(array.tobytes())
    limits = MonitorLimits.of(motion.settings)
    execution = execute(motion.trajectory, Workcell(motion.body), ExecutionSettings(), seed, limits=limits)
    return {"plan": planned.hexdigest(), "execution": execution.digest()}


def compare(seed: int, processes: int, progress: Progress = silent) -> dict[str, list[str]]:
    """Digests of each kind, one for each process."""
    found: dict[str, list[str]] = {}
    for number in range(processes):
        environment = {**os.environ, "PYTHONHASHSEED": str(number + 1), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "faults.digests", "--alone", "--seed", str(seed)]
        said = subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True).stdout
        for kind, digest in json.loads(said.splitlines()[-1]).items():
            found.setdefault(kind, []).append(digest)
        progress(number + 1, processes, "processes")
    return found


def main(arguments: list[str] | None = None) -> int:
    """``python -m faults.digests``."""
    made = parser(__doc__)
    made.add_argument("--processes", type=int, default=3, help="that begin anew (default 3)")
    made.add_argument("--alone", action="store_true", help="print the digests that this process makes, as JSON")
    options = made.parse_args(arguments)
    if options.alone:
        with tempfile.TemporaryDirectory(prefix="deltasafe-faults-") as home:
            print(json.dumps(digests_of(options.seed, pathlib.Path(home))))
        return 0
    del options.alone
    found = compare(options.seed, options.processes, progress_every(1))
    failures = [f"{kind}: {digests}" for kind, digests in found.items() if len({*digests}) != 1]
    figures = {"digests": len(found), "digests_differing": len(failures), "digest_processes": options.processes}
    same = {kind: digests[0] for kind, digests in found.items()}
    return conclude("digests", figures, options, failures, sha256=same)


if __name__ == "__main__":
    sys.exit(main())
