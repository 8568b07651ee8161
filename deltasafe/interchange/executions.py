"""An execution as an MCAP log and back: tool pose, joints, path, clearances, and the scene around it."""

import dataclasses
import pathlib
from typing import Any

import numpy as np

from deltasafe.errors import DataError, SettingsError
from deltasafe.execution.recording import PHASES, Execution
from deltasafe.geometry import Pose
from deltasafe.interchange.frames import WORLD
from deltasafe.interchange.log import LogWriter, read_log
from deltasafe.interchange.scenes import quaternion, upright, vector, write_scene_topics
from deltasafe.planning.body import ToolBody
from deltasafe.scene import LoggedScene

__all__ = ["export_execution", "import_execution"]

TOOL, REFERENCE, JOINTS, SAMPLES = "/tool/pose", "/tool/reference", "/joint_states", "/execution"
PLANNED, DRIVEN = "/path/reference", "/path/executed"
FACTS = "deltasafe.execution"
EVERY = 5
"""Of the recorded poses of a drawn path."""


def export_execution(execution: Execution, destination: str | pathlib.Path, scene: LoggedScene | None = None) -> None:
    """Write a recording as an MCAP log; nothing is lost.

    Args:
        scene: what it was executed in, drawn around it: image, camera, true hand, task.

    Raises:
        DataError: the scene's image is neither JPEG nor PNG.
        SettingsError: the destination does not end in .mcap, or the package mcap is not installed.
    """
    names = [f"joint_{number}" for number in range(1, execution.joint_positions_rad.shape[1] + 1)]
    speed, error = execution.reference_speed_mps, execution.workspace_error_m
    with LogWriter(destination) as log:
        if scene is not None:
            write_scene_topics(log, scene)
        shown = np.flatnonzero(execution.judged)[::EVERY]
        for topic, poses in (
            (PLANNED, [upright(Pose(*map(float, execution.reference_poses[n]))) for n in shown]),
            (DRIVEN, [_measured(execution, n) for n in shown]),
        ):
            log.say(topic, "foxglove.PosesInFrame", 0, {"frame_id": WORLD, "poses": poses})
        for n, time_s in enumerate(execution.time_s):
            time_ns = round(float(time_s) * 1e9)
            log.say(TOOL, "foxglove.PoseInFrame", time_ns, {"frame_id": WORLD, "pose": _measured(execution, n)})
            reference = upright(Pose(*map(float, execution.reference_poses[n])))
            log.say(REFERENCE, "foxglove.PoseInFrame", time_ns, {"frame_id": WORLD, "pose": reference})
            log.say(
                JOINTS,
                "deltasafe.JointState",
                time_ns,
                {
                    "name": names,
                    "position_rad": execution.joint_positions_rad[n].tolist(),
                    "torque_nm": execution.torques_nm[n].tolist(),
                },
            )
            log.say(
                SAMPLES,
                "deltasafe.ExecutionSample",
                time_ns,
                {
                    "time_s": float(time_s),
                    "phase": PHASES[execution.phase[n]],
                    "reference_pose": execution.reference_poses[n].tolist(),
                    "reference_velocity": execution.reference_velocities[n].tolist(),
                    "tool_to_hand_m": _finite(execution.tool_to_hand_m[n]),
                    "arm_to_hand_m": _finite(execution.arm_to_hand_m[n]),
                    "contacts": int(execution.contacts[n]),
                    "reference_speed_mps": float(speed[n]),
                    "workspace_error_m": float(error[n]),
                },
            )
        log.note(
            FACTS,
            {
                "body": dataclasses.asdict(execution.body),
                "seed": execution.seed,
                "stop_reason": execution.stop_reason,
                "digest": execution.digest(),
            },
        )


def import_execution(source: str | pathlib.Path) -> Execution:
    """Read what ``export_execution`` wrote: the same recording, by its digest.

    Raises:
        DataError: the log is damaged, holds no execution, or was altered.
        SettingsError: the package mcap is not installed.
    """
    log = read_log(source)
    facts, samples, joints, tool = log.about(FACTS), log.on(SAMPLES), log.on(JOINTS), log.on(TOOL)
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
            body=ToolBody(**facts["body"]),
            seed=facts["seed"],
            stop_reason=facts["stop_reason"],
        )
    except (KeyError, TypeError, ValueError, SettingsError) as error:
        raise DataError(log.path, f"holds no execution ({error!r}); export it again") from error
    if execution.digest() != facts.get("digest"):
        raise DataError(log.path, "was altered after it was written; export the execution again")
    return execution


def _measured(execution: Execution, n: int) -> dict[str, Any]:
    return {
        "position": vector(execution.tool_positions_m[n]),
        "orientation": quaternion(execution.tool_quaternions[n]),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _or_infinite(value: float | None) -> float:
    return float("inf") if value is None else value
