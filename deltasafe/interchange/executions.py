"""Export of an execution as an MCAP log, and its import: tool pose, joints, path, distances, and the scene."""

import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from deltasafe.errors import DataError, SettingsError
from deltasafe.execution.recording import PHASES, Execution
from deltasafe.geometry import Pose
from deltasafe.interchange.frames import WORLD
from deltasafe.interchange.log_content import NS_PER_S, stamp
from deltasafe.interchange.mcap_log import open_log
from deltasafe.interchange.reading import read_log
from deltasafe.interchange.scenes import quaternion, upright, vector, write_scene_topics
from deltasafe.io.records import from_json
from deltasafe.planning.body import ToolBody
from deltasafe.scene import LoggedScene

TOOL, REFERENCE, JOINTS, SAMPLES = "/tool/pose", "/tool/reference", "/joint_states", "/execution"
PLANNED, DRIVEN = "/path/reference", "/path/executed"
FACTS = "deltasafe.execution"
PATH_EVERY = 5
"""Recorded poses between two poses of a drawn path."""
TOLERANCE = 1e-9


def export_execution(execution: Execution, destination: str | pathlib.Path, scene: LoggedScene | None = None) -> None:
    """Write a recording as a lossless MCAP log.

    Args:
        scene: adds image, camera, true hand and task.

    Raises:
        DataError: the scene's image is neither JPEG nor PNG.
        SettingsError: the destination does not end in .mcap, or the package mcap is not installed.
    """
    with open_log(destination) as log:
        if scene is not None:
            write_scene_topics(log, scene)
        for topic, schema, time_ns, message in _messages(execution):
            log.write_message(topic, schema, time_ns, message)
        log.write_facts(
            FACTS,
            {
                "body": dataclasses.asdict(execution.body),
                "seed": execution.seed,
                "stop_reason": execution.stop_reason,
                "digest": execution.digest(),
            },
        )


def import_execution(source: str | pathlib.Path) -> Execution:
    """Read a log that ``export_execution`` wrote; the recording is identical, by its digest.

    Raises:
        DataError: the log is damaged, holds no execution, or was altered, be it in a field that the recording does not
            need, such as a frame, a time, or the name of a joint.
        SettingsError: the package mcap is not installed.
    """
    log = read_log(source)
    facts, samples, joints, tool = log.facts_named(FACTS), *map(log.messages_on, (SAMPLES, JOINTS, TOOL))
    try:
        execution = Execution(
            time_s=np.array([one["time_s"] for one in samples]),
            phase=np.array([PHASES.index(one["phase"]) for one in samples], np.int8),
            reference_poses=np.array([one["reference_pose"] for one in samples]),
            reference_velocities=np.array([one["reference_velocity"] for one in samples]),
            tool_positions_m=np.array([[one["pose"]["position"][axis] for axis in "xyz"] for one in tool]),
            tool_quaternions=np.array([[one["pose"]["orientation"][axis] for axis in "xyzw"] for one in tool]),
            joint_positions_rad=np.array([one["position_rad"] for one in joints]),
            torques_nm=np.array([one["torque_nm"] for one in joints]),
            tool_to_hand_m=np.array([_or_infinite(one["tool_to_hand_m"]) for one in samples]),
            arm_to_hand_m=np.array([_or_infinite(one["arm_to_hand_m"]) for one in samples]),
            contacts=np.array([one["contacts"] for one in samples], np.int32),
            body=from_json(ToolBody, facts["body"]),
            seed=facts["seed"],
            stop_reason=facts["stop_reason"],
        )
        expected: dict[str, list[dict[str, Any]]] = {}
        for topic, _, time_ns, message in _messages(execution):
            expected.setdefault(topic, []).append({"timestamp": stamp(time_ns), **message})
    except (KeyError, TypeError, ValueError, OverflowError, SettingsError) as error:
        raise DataError(log.path, f"holds no execution ({error!r}); export it again") from error
    if execution.digest() != facts.get("digest"):
        raise DataError(log.path, "was altered after it was written; export the execution again")
    for topic, messages in expected.items():
        if not _same(messages, log.messages.get(topic, messages)):  # topics that are only drawn may be missing
            raise DataError(log.path, f"contradicts itself on {topic}, it was altered; export the execution again")
    return execution


def _messages(execution: Execution) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """Topic, schema, time and content of each message of an execution."""
    names = [f"joint_{number}" for number in range(1, execution.joint_positions_rad.shape[1] + 1)]
    speed, error = execution.reference_speed_mps, execution.workspace_error_m
    shown = np.flatnonzero(execution.judged)[::PATH_EVERY]
    for topic, poses in (
        (PLANNED, [upright(Pose(*map(float, execution.reference_poses[n]))) for n in shown]),
        (DRIVEN, [_measured(execution, n) for n in shown]),
    ):
        yield topic, "foxglove.PosesInFrame", 0, {"frame_id": WORLD, "poses": poses}
    for n, time_s in enumerate(execution.time_s):
        time_ns = round(float(time_s) * NS_PER_S)
        pose = {"frame_id": WORLD, "pose": _measured(execution, n)}
        yield TOOL, "foxglove.PoseInFrame", time_ns, pose
        reference = {"frame_id": WORLD, "pose": upright(Pose(*map(float, execution.reference_poses[n])))}
        yield REFERENCE, "foxglove.PoseInFrame", time_ns, reference
        joints = {
            "name": names,
            "position_rad": execution.joint_positions_rad[n].tolist(),
            "torque_nm": execution.torques_nm[n].tolist(),
        }
        yield JOINTS, "deltasafe.JointState", time_ns, joints
        sample = {
            "time_s": float(time_s),
            "phase": PHASES[execution.phase[n]],
            "reference_pose": execution.reference_poses[n].tolist(),
            "reference_velocity": execution.reference_velocities[n].tolist(),
            "tool_to_hand_m": _finite(execution.tool_to_hand_m[n]),
            "arm_to_hand_m": _finite(execution.arm_to_hand_m[n]),
            "contacts": int(execution.contacts[n]),
            "reference_speed_mps": float(speed[n]),
            "workspace_error_m": float(error[n]),
        }
        yield SAMPLES, "deltasafe.ExecutionSample", time_ns, sample


def _measured(execution: Execution, n: int) -> dict[str, Any]:
    return {
        "position": vector(execution.tool_positions_m[n]),
        "orientation": quaternion(execution.tool_quaternions[n]),
    }


def _same(one: Any, other: Any) -> bool:
    """Whether two JSON values are equal. Derived numbers may differ in the last digits between versions of NumPy."""
    if isinstance(one, dict):
        return (
            isinstance(other, dict) and one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
        )
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(_same, one, other))
    if type(one) in (int, float) and type(other) in (int, float):
        return abs(one - other) <= TOLERANCE * max(1.0, abs(one))
    return type(one) is type(other) and bool(one == other)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _or_infinite(value: float | None) -> float:
    return float("inf") if value is None else value
