"""Execution of planned motions on a simulated iiwa 14: control, monitor, recording and evaluation."""

from deltasafe.execution.arm import Arm, ArmState, Dynamics
from deltasafe.execution.camera_watch import CameraWatch
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.disturbances import Disturbance, Payload, Push
from deltasafe.execution.film import FilmSettings, save_film
from deltasafe.execution.impedance import ImpedanceSettings
from deltasafe.execution.kinematics import ArmMount, IiwaKinematics, JointLimits
from deltasafe.execution.monitor import MonitorLimits
from deltasafe.execution.recording import PHASES, Execution
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.execution.simulate import execute
from deltasafe.execution.verdict import SafetyVerdict, SpeedBin, evaluate_execution
from deltasafe.execution.workcell import Workcell

__all__ = [
    "PHASES",
    "Arm",
    "ArmMount",
    "ArmState",
    "CameraWatch",
    "Disturbance",
    "Dynamics",
    "Execution",
    "ExecutionSettings",
    "FilmSettings",
    "IiwaKinematics",
    "ImpedanceSettings",
    "JointLimits",
    "MeshDistance",
    "MonitorLimits",
    "Payload",
    "Push",
    "SafetyVerdict",
    "SpeedBin",
    "Workcell",
    "evaluate_execution",
    "execute",
    "save_film",
]
