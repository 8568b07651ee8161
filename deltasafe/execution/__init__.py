"""Execution of planned motions on a simulated arm: control, monitor, recording and evaluation."""

from deltasafe.execution.arm import Arm, ArmState, Dynamics, JointLimits
from deltasafe.execution.arm_models import ArmSettings
from deltasafe.execution.camera_watch import CameraWatch
from deltasafe.execution.distance import MeshDistance
from deltasafe.execution.film import save_film
from deltasafe.execution.impedance import ImpedanceSettings
from deltasafe.execution.monitor import MonitorLimits
from deltasafe.execution.recording import PHASES, Execution
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.execution.simulate import execute
from deltasafe.execution.verdict import SafetyVerdict, evaluate_execution
from deltasafe.execution.workcell import Workcell

__all__ = [
    "PHASES",
    "Arm",
    "ArmSettings",
    "ArmState",
    "CameraWatch",
    "Dynamics",
    "Execution",
    "ExecutionSettings",
    "ImpedanceSettings",
    "JointLimits",
    "MeshDistance",
    "MonitorLimits",
    "SafetyVerdict",
    "Workcell",
    "evaluate_execution",
    "execute",
    "save_film",
]
