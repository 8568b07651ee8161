"""Digests of everything that a chain or a study makes, and the check of two concurrent runs in Dagster's event log."""

import dataclasses
import hashlib
import pathlib
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import dagster as dg
import numpy as np

from deltasafe.io.storage import digest_of
from deltasafe.studies.planner import Comparison
from evidence.fixtures import first_hands
from pipelines.home import DATASETS

STUDY_ASSETS = {"planner_costs", "planner_times", "planner_report"}


def study_digest(study: Comparison) -> str:
    """Return the SHA-256 of all plans, without their times."""
    state = hashlib.sha256(digest_of(study.settings).encode())
    for name, values in sorted(study.runs.items()):
        if name != "seconds":
            state.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return state.hexdigest()


def chain_digests(home: pathlib.Path) -> dict[str, str]:
    """Return digests of the augmented set, the members, the frozen ensemble, every motion and every execution."""
    from assets.perception import members
    from deltasafe.perception.data.augmented_set import AugmentedSet
    from deltasafe.perception.training.member import Member
    from deltasafe.trials.executions import load_execution, load_outcomes
    from deltasafe.trials.motions import load_motion
    from pipelines.storage.io_manager import FolderPointers

    pointers = FolderPointers(home=str(home))

    def folder(asset: str, partition: str | None = None) -> pathlib.Path:
        return pointers.folder(dg.AssetKey(asset), partition)

    found = {
        "augmented set": AugmentedSet.load(folder("augmented_hands")).digest,
        "frozen ensemble": folder("frozen_ensemble").name,
        "ensemble in use": folder("champion").name,
    }
    for name in members.get_partition_keys():
        found[name] = str(Member.load(folder("ensemble_member", name)).record["weights_sha256"])
    motions, executions = folder("planned_motions"), folder("executed_motions")
    for outcome in load_outcomes(executions):
        motion = load_motion(motions, outcome.scene_id).trajectory
        arrays: Any = [] if motion is None else [motion.time_s, motion.poses, motion.velocities]
        found[f"motion of {outcome.scene_id}"] = digest_of([np.asarray(array).tobytes().hex() for array in arrays])
        digest = load_execution(executions, outcome.scene_id).digest() if outcome.executed else outcome.reason
        found[f"execution of {outcome.scene_id}"] = digest
    return found


def augmentation_costs() -> dict[str, float]:
    """Return CPU seconds and megabytes of one more augmented image in two presets, measured with three originals."""
    from deltasafe.perception.data.augmented_set import augment_images
    from deltasafe.presets import PRESETS

    hands, found = first_hands(3), {}
    with tempfile.TemporaryDirectory(prefix="deltasafe-scale-") as folder:
        for name in ("default", "paper"):
            costs = []
            for n_variants in (1, 21):
                settings = dataclasses.replace(PRESETS[name].augmentation, n_variants=n_variants)
                began_s, made = time.process_time(), pathlib.Path(folder) / f"{name}-{n_variants}"
                augment_images(hands, made, settings, DATASETS / "backgrounds", workers=1)
                costs.append((time.process_time() - began_s, megabytes(made)))
            for index, what in enumerate(("augmentation_cpu_s", "augmented_mb")):
                found[f"{what}_{name}"] = round((costs[1][index] - costs[0][index]) / (20 * len(hands)), 4)
    return found


def megabytes(folder: pathlib.Path) -> float:
    """Return the size of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def run(arguments: Sequence[str]) -> int:
    """Run the job `planner_study` with a first seed in the home of the environment, or only prepare the home.

    Args:
        arguments: the first seed, or ``prepare``; preparing before concurrent runs creates Dagster's database once.
    """
    from pipelines.commands.run_job import run_to_end
    from pipelines.home import prepare_home

    prepare_home()
    if arguments[0] == "prepare":
        dg.DagsterInstance.get().dispose()
        return 0
    study = {"study": {"first_seed": int(arguments[0])}}
    steps = {name: study for name in ("planner_costs", "planner_times")}
    return 0 if run_to_end("planner_study", steps, "the same command") else 1


def check_both_ran(home: pathlib.Path) -> tuple[bool, list[str]]:
    """Check that two planner studies ran at the same time, each with its own steps, jobs, batches and assets.

    Returns the result and lines that explain it.
    """
    lines, spans, jobs, complete = [], [], set(), []
    with dg.DagsterInstance.from_config(str(home / "dagster")) as instance:
        for record in instance.get_run_records(dg.RunsFilter(job_name="planner_study")):
            dagster_run = record.dagster_run
            entries = instance.all_logs(dagster_run.run_id)
            events = [entry.dagster_event for entry in entries if entry.dagster_event]
            steps, assets, submitted = _worked(events)
            lines.append(
                f"run {dagster_run.run_id[:8]}: {dagster_run.status.value}, {len(steps)} steps, "
                f"{len(submitted)} jobs of the cluster, materialized {', '.join(sorted(assets))}"
            )
            lines += [f"{event.step_key}: {_reason(event)}" for event in events if event.is_step_failure]
            made_all = steps == assets == STUDY_ASSETS and len(submitted) == len(STUDY_ASSETS)
            complete.append(dagster_run.is_success and made_all)
            jobs |= submitted
            spans.append((record.start_time or 0.0, record.end_time or 0.0))
    overlap = len(spans) == 2 and max(begin for begin, _ in spans) < min(end for _, end in spans)
    batches = len(list((home / "store" / "planner_costs" / "batches").glob("*.npz")))
    lines.append(f"at the same time: {overlap}; {batches} batches of costs, {len(jobs)} jobs")
    return overlap and all(complete) and batches == 8 and len(jobs) == 6, lines


def _worked(events: Sequence[dg.DagsterEvent]) -> tuple[set[str | None], set[str], set[str]]:
    """Return the successful steps, the materialized assets and the IDs of the submitted jobs."""
    kinds = dg.DagsterEventType
    return (
        {event.step_key for event in events if event.event_type == kinds.STEP_SUCCESS},
        {
            event.asset_key.to_user_string()
            for event in events
            if event.event_type == kinds.ASSET_MATERIALIZATION and event.asset_key
        },
        {
            str(event.engine_event_data.metadata["Ray Submission ID"].value)
            for event in events
            if event.event_type == kinds.STEP_WORKER_STARTING
        },
    )


def _reason(event: dg.DagsterEvent) -> str:
    error = event.step_failure_data.error
    return " ".join(f"{event.message} {error.message if error else ''}".split())[:600]
