"""What the chain itself stores and reads again: members, fields, motions, executions, registries of files."""

import hashlib
import json
import pathlib
from random import Random

import numpy as np

from deltasafe.execution import Execution
from deltasafe.geometry import PosePath, Trajectory
from deltasafe.perception.hands import read_registry
from deltasafe.perception.member import Member
from deltasafe.planning import (
    MotionSettings,
    PlannedMotion,
    PlanResult,
    PlanStatus,
    SpeedProfile,
    ToolBody,
    TrackingBound,
)
from deltasafe.scene import OccupancyGrid, Sphere, grid_from_shapes
from evidence.faults.judging import Case, Door, Spoil
from evidence.faults.malformed.documents import changed, document_spoils, field_spoils
from evidence.faults.malformed.files import at, file_spoils, filled
from evidence.faults.malformed.packed import array_spoils, with_array
from evidence.faults.malformed.weights import weight_spoils

__all__ = ["recording_cases"]


def recording_cases(home: pathlib.Path, member: pathlib.Path) -> list[Case]:
    """Of every kind of folder that later steps, or other projects, read."""
    return [*_executions(home), *_motions(home), *_grids(home), *_members(member), *_registries(home)]


def _executions(home: pathlib.Path) -> list[Case]:
    sound, count = home / "execution", 30
    Execution(
        reference_poses=np.zeros((count, 4)),
        reference_velocities=np.zeros((count, 4)),
        time_s=np.arange(count) / 100,
        phase=np.repeat([0, 2, 4], 10),
        tool_positions_m=np.zeros((count, 3)),
        tool_quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        joint_positions_rad=np.zeros((count, 7)),
        torques_nm=np.zeros((count, 7)),
        tool_to_hand_m=np.ones(count),
        arm_to_hand_m=np.ones(count),
        contacts=np.zeros(count, np.int32),
        body=ToolBody(),
        seed=0,
    ).save(sound)

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        Execution.load(given)

    door = Door("execution", sound, read, lambda given, out: ["export", str(given), str(out / "run.mcap")])
    about = json.loads((sound / "execution.json").read_text())
    unread = ("missing", "a folder", "a pipe", "a link to nowhere", "a link to itself")
    spoils: dict[str, Spoil] = {}
    for name, change in document_spoils().items():
        spoil = at("execution.json", change)
        spoils[f"execution.json: {name}"] = _naming_folder(spoil) if name in unread else spoil
    for name, change in field_spoils(about, ("format", "body", "body.semi_axis_x_m", "seed", "stop_reason", "digest")):
        if name != "without body.semi_axis_x_m":  # which is what it is without being said
            spoils[f"execution.json: {name}"] = _naming_folder(at("execution.json", change))
    for name, change in array_spoils(sound / "arrays.npz").items():
        spoils[f"arrays.npz: {name}"] = _naming_folder(at("arrays.npz", change))
    altered = {
        "tool_to_hand_m": np.full(count, 2.0),
        "time_s": np.arange(29.0),
        "reference_poses": np.zeros((count, 3)),
    }
    for name, value in altered.items():
        spoils[f"arrays.npz: another {name}"] = _naming_folder(at("arrays.npz", with_array(name, value)))
    return [Case(name, door, spoil) for name, spoil in spoils.items()]


def _motions(home: pathlib.Path) -> list[Case]:
    sound, poses = home / "motion", np.array([[0.0, 0.0, 0.03, 0.0], [0.1, 0.0, 0.03, 0.0]])
    column = np.array([0.01, 0.01])
    PlannedMotion(
        PlanResult(PlanStatus.SOLVED, PosePath(poses), 0.001, 0.01, 0.1, 0.01, 0.003, 10, 5, 3, "solved"),
        Trajectory(np.array([0.0, 1.0]), poses, np.zeros((2, 4))),
        SpeedProfile(np.array([0.0, 0.1]), column, column, column, poses),
        "",
        MotionSettings(),
        ToolBody(),
        TrackingBound(),
        0,
    ).save(sound)

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        PlannedMotion.load(given)

    door = Door("motion", sound, read)
    record = json.loads((sound / "motion.json").read_text())
    fields = ("format", "result", "result.status", "settings", "settings.method", "body", "tracking")
    spoils = {f"motion.json: {name}": at("motion.json", change) for name, change in document_spoils().items()}
    for name, change in field_spoils(record, fields):
        if not name.startswith("without settings.") and name not in ("settings is {}", "body is {}", "tracking is {}"):
            spoils[f"motion.json: {name}"] = _naming_folder(at("motion.json", change))
    for field, value in (
        ("result.status", "hope"),
        ("settings.delta", 2.0),
        ("settings.surplus", 1),
        ("reason", "none"),
    ):
        spoils[f"motion.json: {field} is {value!r}"] = _naming_folder(at("motion.json", changed(field, value)))
    for name, change in array_spoils(sound / "motion.npz").items():
        spoils[f"motion.npz: {name}"] = _naming_folder(at("motion.npz", change))
    spoils["motion.npz: time that stands still"] = _naming_folder(
        at("motion.npz", with_array("trajectory_time_s", np.zeros(2)))
    )
    return [Case(name, door, spoil) for name, spoil in spoils.items()]


def _grids(home: pathlib.Path) -> list[Case]:
    sound = home / "grid.npz"
    grid_from_shapes([Sphere((0, 0, 0.03), 0.02)], 0.01, (-0.1, -0.1, 0.0), (0.1, 0.1, 0.06), 0.01).save(sound)

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        OccupancyGrid.load(given)

    door = Door("field", sound, read)
    wrong = {
        "p_occupied": [np.full((4, 4, 4), np.nan), np.full((4, 4, 4), 1.5), np.full((4, 4, 4), -0.1), np.zeros((4, 4))],
        "origin_m": [np.array([0.0, np.nan, 0.0]), np.zeros(2)],
        "voxel_m": [np.array(0.0), np.array(-0.01), np.array(np.nan), np.array(np.inf), np.ones(2)],
    }
    spoils = array_spoils(sound)
    for name, values in wrong.items():
        for n, value in enumerate(values):
            spoils[f"impossible {name}, {n}"] = with_array(name, value)
    return [Case(name, door, at("", change)) for name, change in spoils.items()]


def _members(sound: pathlib.Path) -> list[Case]:
    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        Member.load(given).network()

    door = Door("member", sound, read)
    record = json.loads((sound / "member.json").read_text())
    spoils = {f"member.json: {name}": at("member.json", change) for name, change in document_spoils().items()}
    for name, change in field_spoils(record, ("weights_sha256", "settings", "settings.network")):
        spoils[f"member.json: {name}"] = _naming_folder(at("member.json", change))
    for name, change in file_spoils().items():
        spoils[f"weights: {name}"] = at("weights.safetensors", change)
    for name, change in weight_spoils().items():

        def spoil(given: pathlib.Path, random: Random, change=change) -> str:  # type: ignore[no-untyped-def]
            change(given / "weights.safetensors", random)
            digest = hashlib.sha256((given / "weights.safetensors").read_bytes()).hexdigest()
            changed("weights_sha256", digest)(given / "member.json", random)
            return "weights.safetensors"

        spoils[f"weights, their digest right: {name}"] = spoil
    return [Case(name, door, spoil) for name, spoil in spoils.items()]


def _registries(home: pathlib.Path) -> list[Case]:
    sound = home / "registry.sha256"
    sound.write_text(f"{'0' * 64}  images/a.png\n")

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        read_registry(given)

    door, spoils = Door("registry", sound, read), file_spoils()
    for name in ("empty", "half of it"):
        del spoils[name]
    spoils["a short digest"] = filled(b"0000  images/a.png\n")
    spoils["no path"] = filled(b"0" * 64 + b"\n")
    spoils["not UTF-8"] = filled(b"\xff" * 64 + b"  a.png\n")
    return [Case(name, door, at("", change)) for name, change in spoils.items()]


def _naming_folder(spoil: Spoil) -> Spoil:
    """What two files say together is about their folder."""

    def spoilt(given: pathlib.Path, random: Random) -> str:
        spoil(given, random)
        return given.name

    return spoilt
