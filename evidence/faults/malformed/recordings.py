"""Corruptions of what the chain stores and reads again: members, grids, motions, executions and registries."""

import hashlib
import json
import pathlib
from collections.abc import Callable
from random import Random

import numpy as np

from deltasafe.execution import Execution
from deltasafe.geometry import PosePath, Trajectory
from deltasafe.io.checksum_list import read_registry
from deltasafe.perception.training.member import Member
from deltasafe.planning import (
    MotionSettings,
    PlannedMotion,
    PlanResult,
    PlanStatus,
    SpeedProfile,
)
from deltasafe.scene import OccupancyGrid
from evidence.faults.malformed.documents import document_changes, field_changes, with_field
from evidence.faults.malformed.files import (
    NOT_A_FILE,
    at,
    blaming_folder,
    cases_of,
    file_cases,
    file_changes,
    filled,
    prefixed,
)
from evidence.faults.malformed.packed import array_changes, with_array
from evidence.faults.malformed.tasks import ball_grid
from evidence.faults.malformed.weights import weight_changes
from evidence.faults.rejection import Case, Change, Corruption, InputKind
from evidence.fixtures import synthetic_execution


def recording_cases(home: pathlib.Path, member: pathlib.Path) -> list[Case]:
    """Every kind of folder that later steps or other projects read."""
    return [*_executions(home), *_motions(home), *_grids(home), *_members(member), *_registries(home)]


def _in_folder(name: str) -> Callable[[Change], Corruption]:
    """Change one file; the error must name the folder, because the files contradict each other."""
    return lambda change: blaming_folder(at(name, change))


def _executions(home: pathlib.Path) -> list[Case]:
    valid, count = home / "execution", 30
    synthetic_execution(count, 0).save(valid)
    kind = InputKind(
        "execution",
        valid,
        lambda given, out: Execution.load(given),
        lambda given, out: ["export", str(given), str(out / "run.mcap")],
    )
    about = json.loads((valid / "execution.json").read_text())
    fields = dict(field_changes(about, ("format", "body", "body.semi_axis_x_m", "seed", "stop_reason", "digest")))
    del fields["without body.semi_axis_x_m"]  # the default value is the same
    document = document_changes()
    missing = {name: document.pop(name) for name in NOT_A_FILE}
    arrays = {
        **array_changes(valid / "arrays.npz"),
        "another tool_to_hand_m": with_array("tool_to_hand_m", np.full(count, 2.0)),
        "another time_s": with_array("time_s", np.arange(29.0)),
        "another reference_poses": with_array("reference_poses", np.zeros((count, 3))),
    }
    return cases_of(
        kind,
        {
            **prefixed("execution.json", document, lambda change: at("execution.json", change)),
            **prefixed("execution.json", {**missing, **fields}, _in_folder("execution.json")),
            **prefixed("arrays.npz", arrays, _in_folder("arrays.npz")),
        },
    )


def _motions(home: pathlib.Path) -> list[Case]:
    valid, poses = home / "motion", np.array([[0.0, 0.0, 0.03, 0.0], [0.1, 0.0, 0.03, 0.0]])
    column = np.array([0.01, 0.01])
    PlannedMotion(
        PlanResult(PlanStatus.SOLVED, PosePath(poses), 0.001, 0.01, 0.1, 0.01, 0.003, 10, 5, 3, "solved"),
        Trajectory(np.array([0.0, 1.0]), poses, np.zeros((2, 4))),
        SpeedProfile(np.array([0.0, 0.1]), column, column, column, poses),
        "",
        MotionSettings(),
        0,
    ).save(valid)
    record = json.loads((valid / "motion.json").read_text())
    names = ("format", "result", "result.status", "settings", "settings.method", "settings.body")
    fields = {
        name: change
        for name, change in field_changes(record, names)
        if not name.startswith("without settings.") and name not in ("settings is {}", "body is {}", "tracking is {}")
    }
    values = [("result.status", "hope"), ("settings.delta", 2.0), ("settings.surplus", 1), ("reason", "none")]
    fields |= {f"{field} is {value!r}": with_field(field, value) for field, value in values}
    arrays = {
        **array_changes(valid / "motion.npz"),
        "times that do not increase": with_array("trajectory_time_s", np.zeros(2)),
    }
    return cases_of(
        InputKind("motion", valid, lambda given, out: PlannedMotion.load(given)),
        {
            **prefixed("motion.json", document_changes(), lambda change: at("motion.json", change)),
            **prefixed("motion.json", fields, _in_folder("motion.json")),
            **prefixed("motion.npz", arrays, _in_folder("motion.npz")),
        },
    )


def _grids(home: pathlib.Path) -> list[Case]:
    valid = home / "grid.npz"
    ball_grid().save(valid)
    values = {
        "p_occupied": [np.full((4, 4, 4), np.nan), np.full((4, 4, 4), 1.5), np.full((4, 4, 4), -0.1), np.zeros((4, 4))],
        "origin_m": [np.array([0.0, np.nan, 0.0]), np.zeros(2)],
        "voxel_m": [np.array(0.0), np.array(-0.01), np.array(np.nan), np.array(np.inf), np.ones(2)],
    }
    changes = array_changes(valid)
    for name, arrays in values.items():
        changes |= {f"invalid {name}, {n}": with_array(name, array) for n, array in enumerate(arrays)}
    return file_cases(InputKind("field", valid, lambda given, out: OccupancyGrid.load(given)), changes)


def _members(valid: pathlib.Path) -> list[Case]:
    record = json.loads((valid / "member.json").read_text())
    fields = dict(field_changes(record, ("weights_sha256", "settings", "settings.network")))
    return cases_of(
        InputKind("member", valid, lambda given, out: Member.load(given).network()),
        {
            **prefixed("member.json", document_changes(), lambda change: at("member.json", change)),
            **prefixed("member.json", fields, _in_folder("member.json")),
            **prefixed("weights", file_changes(), lambda change: at("weights.safetensors", change)),
            **prefixed("weights with a matching digest", weight_changes(), _weights_with_digest),
        },
    )


def _weights_with_digest(change: Change) -> Corruption:
    def corrupt(given: pathlib.Path, random: Random) -> str:
        weights = given / "weights.safetensors"
        change(weights, random)
        with_field("weights_sha256", hashlib.sha256(weights.read_bytes()).hexdigest())(given / "member.json", random)
        return weights.name

    return corrupt


def _registries(home: pathlib.Path) -> list[Case]:
    valid = home / "registry.sha256"
    valid.write_text(f"{'0' * 64}  images/a.png\n")
    changes = file_changes()
    for name in ("empty", "truncated"):
        del changes[name]
    changes["a short digest"] = filled(b"0000  images/a.png\n")
    changes["no path"] = filled(b"0" * 64 + b"\n")
    changes["not UTF-8"] = filled(b"\xff" * 64 + b"  a.png\n")
    return file_cases(InputKind("registry", valid, lambda given, out: read_registry(given)), changes)
