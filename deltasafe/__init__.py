"""From fifty labeled images to a robot that moves safely close to a human hand.

The names below are the public API for planning and for using a frozen ensemble. `deltasafe.perception` has the API for
training one. Importing this package loads neither torch nor a simulator.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deltasafe.errors import ArtifactError, DeltasafeError
    from deltasafe.geometry import Pose
    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
    from deltasafe.planning import MotionSettings, PlannedMotion, ToolBody, plan_motion, verify_motion
    from deltasafe.scene import (
        Camera,
        Cuboid,
        FieldSettings,
        ImageStamp,
        LoggedScene,
        OccupancyGrid,
        Sphere,
        grid_from_image,
        grid_from_shapes,
    )
    from deltasafe.trials.motion_figure import plan_over_image

__all__ = [
    "ArtifactError",
    "Camera",
    "Cuboid",
    "DeltasafeError",
    "FieldSettings",
    "ImageStamp",
    "LoggedScene",
    "MotionSettings",
    "OccupancyGrid",
    "PlannedMotion",
    "Pose",
    "Sphere",
    "ToolBody",
    "__version__",
    "grid_from_image",
    "grid_from_shapes",
    "load_ensemble",
    "plan_motion",
    "plan_over_image",
    "verify_motion",
]

__version__ = "0.1.0"
"""Version of the package."""

_HOMES = {
    "deltasafe.errors": ["ArtifactError", "DeltasafeError"],
    "deltasafe.geometry": ["Pose"],
    "deltasafe.perception.artifact.frozen_ensemble": ["load_ensemble"],
    "deltasafe.planning": ["MotionSettings", "PlannedMotion", "ToolBody", "plan_motion", "verify_motion"],
    "deltasafe.scene": [
        "Camera",
        "Cuboid",
        "FieldSettings",
        "ImageStamp",
        "LoggedScene",
        "OccupancyGrid",
        "Sphere",
        "grid_from_image",
        "grid_from_shapes",
    ],
    "deltasafe.trials.motion_figure": ["plan_over_image"],
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Import a public name on first use: planning must not load torch, and `load_ensemble` needs it."""
    if name == "perception":
        return importlib.import_module("deltasafe.perception")
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
