"""Carrying a planned motion out on a simulated iiwa 14, watching it, and judging what was executed."""

from deltasafe.execution.arm import Arm, ArmState, Dynamics, FloatingTool
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.disturbances import Disturbance, Payload, Push
from deltasafe.execution.dynamics import ChainModel
from deltasafe.execution.film import FilmSettings, film_frames, save_film
from deltasafe.execution.impedance import ImpedanceSettings, TaskReference, impedance_torques
from deltasafe.execution.kinematics import IIWA14_LIMITS, ArmMount, IiwaKinematics, JointLimits
from deltasafe.execution.monitor import CameraWatch
from deltasafe.execution.recording import PHASES, Execution
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.execution.simulate import execute, iiwa_for
from deltasafe.execution.verdict import SafetyVerdict, SpeedBin, judge

__all__ = [
    "IIWA14_LIMITS",
    "PHASES",
    "Arm",
    "ArmMount",
    "ArmState",
    "CameraWatch",
    "ChainModel",
    "Disturbance",
    "Dynamics",
    "Execution",
    "ExecutionSettings",
    "FilmSettings",
    "FloatingTool",
    "IiwaKinematics",
    "ImpedanceSettings",
    "JointLimits",
    "MeshDistance",
    "Payload",
    "Push",
    "SafetyVerdict",
    "SpeedBin",
    "TaskReference",
    "execute",
    "film_frames",
    "iiwa_for",
    "impedance_torques",
    "judge",
    "save_film",
]
