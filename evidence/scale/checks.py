"""What `make scale` looks at: digests of all that was made, and what two runs at once left in Dagster's log."""

import dataclasses
import hashlib
import pathlib
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from deltasafe.planner_study import Comparison
from deltasafe.storage import digest_of

if TYPE_CHECKING:
    import dagster as dg

__all__ = ["Evidence", "augmentation_costs", "both_ran", "chain_digests", "megabytes", "run_study", "study_digest"]


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Whether something holds, and what was seen of it."""

    holds: bool
    lines: tuple[str, ...]


def study_digest(study: Comparison) -> str:
    """SHA-256 over all plans, without the times that they took."""
    state = hashlib.sha256(digest_of(study.settings).encode())
    for name, values in sorted(study.runs.items()):
        if name != "seconds":
            state.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return state.hexdigest()


def chain_digests(home: pathlib.Path) -> dict[str, str]:
    """Of the augmented set, the members, the frozen ensemble, every planned motion and every execution."""
    import dagster as dg

    from assets.perception import members
    from deltasafe.perception.augmented_set import AugmentedSet
    from deltasafe.perception.member import Member
    from deltasafe.trials.executions import load_execution, load_outcomes
    from deltasafe.trials.motions import load_motion
    from pipelines.io import FolderPointers

    folder = FolderPointers(home=str(home)).folder

    def made(asset: str, partition: str | None = None) -> pathlib.Path:
        return folder(dg.AssetKey(asset), partition)

    found = {
        "augmented set": AugmentedSet.load(made("augmented_hands")).digest,
        "frozen ensemble": made("frozen_ensemble").name,
        "ensemble in use": made("champion").name,
    }
    for name in members.get_partition_keys():
        found[name] = str(Member.load(made("ensemble_member", name)).record["weights_sha256"])
    motions, executions = made("planned_motions"), made("executed_motions")
    for outcome in load_outcomes(executions):
        motion = load_motion(motions, outcome.scene_id).trajectory
        arrays: Any = [] if motion is None else [motion.time_s, motion.poses, motion.velocities]
        found[f"motion of {outcome.scene_id}"] = digest_of([np.asarray(array).tobytes().hex() for array in arrays])
        run = load_execution(executions, outcome.scene_id).digest() if outcome.executed else outcome.reason
        found[f"execution of {outcome.scene_id}"] = run
    return found


def augmentation_costs(folder: pathlib.Path) -> dict[str, float]:
    """CPU seconds, and megabytes on disk, that one more augmented image takes in two presets; of three originals."""
    from deltasafe.perception.augmented_set import write_augmented_set
    from deltasafe.perception.hands import HandSet
    from deltasafe.presets import PRESETS
    from pipelines.home import DATASETS

    hands = HandSet.load(DATASETS / "hands" / "train")
    few, found = dataclasses.replace(hands, items=hands.items[:3], pixel_digests=hands.pixel_digests[:3]), {}
    for name in ("default", "paper"):
        took = []
        for n_variants in (1, 21):
            settings = dataclasses.replace(PRESETS[name].augmentation, n_variants=n_variants)
            began_s, made = time.process_time(), folder / f"{name}-{n_variants}"
            write_augmented_set(few, DATASETS / "backgrounds", settings, made, workers=1)
            took.append((time.process_time() - began_s, megabytes(made)))
        for index, what in enumerate(("augmentation_cpu_s", "augmented_mb")):
            found[f"{what}_{name}"] = round((took[1][index] - took[0][index]) / (20 * len(few)), 4)
    return found


def megabytes(folder: pathlib.Path) -> float:
    """Of all files below ``folder``."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def run_study(first_seed: int) -> int:
    """One run of the job `planner_study` in the home that the environment names; 0 if it succeeded."""
    import dagster as dg

    from pipelines.home import prepare_home
    from pipelines.planner_study import planner_study
    from pipelines.running import succeeded

    prepare_home()
    steps = {name: {"study": {"first_seed": first_seed}} for name in ("planner_costs", "planner_times")}
    return 0 if succeeded(dg.reconstructable(planner_study), steps, "the same command") else 1


def both_ran(home: pathlib.Path) -> Evidence:
    """Two runs of the planner study: at the same time, each with its own steps, batches and materialisations."""
    import dagster as dg

    lines, spans, jobs, made = [], [], set(), []
    with dg.DagsterInstance.from_config(str(home / "dagster")) as instance:
        for record in instance.get_run_records(dg.RunsFilter(job_name="planner_study")):
            run = record.dagster_run
            events = [entry.dagster_event for entry in instance.all_logs(run.run_id) if entry.dagster_event]
            worked = {event.step_key for event in events if event.event_type == dg.DagsterEventType.STEP_SUCCESS}
            assets = {
                event.asset_key.to_user_string()
                for event in events
                if event.event_type == dg.DagsterEventType.ASSET_MATERIALIZATION and event.asset_key
            }
            submitted = {
                str(event.engine_event_data.metadata["Ray Submission ID"].value)
                for event in events
                if event.event_type == dg.DagsterEventType.STEP_WORKER_STARTING
            }
            lines.append(
                f"run {run.run_id[:8]}: {run.status.value}, {len(worked)} steps, {len(submitted)} jobs of the cluster, "
                f"materialised {', '.join(sorted(assets))}"
            )
            lines += [f"{event.step_key}: {_reason(event)}" for event in events if event.is_step_failure]
            made.append(run.is_success and worked == assets == _ASSETS and len(submitted) == len(_ASSETS))
            jobs |= submitted
            spans.append((record.start_time or 0.0, record.end_time or 0.0))
    together = len(spans) == 2 and max(begin for begin, _ in spans) < min(end for _, end in spans)
    batches = len(list((home / "store" / "planner_costs" / "batches").glob("*.npz")))
    lines.append(f"at the same time: {together}; {batches} batches of costs, {len(jobs)} jobs")
    return Evidence(together and all(made) and batches == 8 and len(jobs) == 6, tuple(lines))


def _reason(event: "dg.DagsterEvent") -> str:
    error = event.step_failure_data.error
    return " ".join(f"{event.message} {error.message if error else ''}".split())[:600]


_ASSETS = {"planner_costs", "planner_times", "planner_report"}
