"""Arms that can carry the tool: settings that choose one, and the data of the arms with a name."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmMount, JointLimits
from deltasafe.execution.iiwa_kinematics import IIWA14_LIMITS, IiwaKinematics

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class ArmSettings:
    """Which arm carries the tool.

    Attributes:
        model: `iiwa` (KUKA LBR iiwa 14), `panda` (Franka Panda), or the path of a URDF file of another arm. Limits of
            joints are those of the URDF file, within its soft limits.
        flange_link: link of the URDF file that carries the tool; a gripper on it and other branches are left out.
        flange_xyz_m, flange_rpy_rad: frame of the flange in that link; empty for the frame of the link. The shaft of
            the tool leaves along z, the first semi-axis of the disc is along x.
        base_pose: x, y and height above the table in m, and yaw in rad, of the arm's base; empty for the default.
        rest_rad: posture that the arm stays near, one angle for each joint; empty for the default, the middle of each
            range. Not for the iiwa, whose elbow points up.
    """

    model: str = "iiwa"
    flange_link: str = ""
    flange_xyz_m: tuple[float, ...] = ()
    flange_rpy_rad: tuple[float, ...] = ()
    base_pose: tuple[float, ...] = ()
    rest_rad: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, count in (("flange_xyz_m", 3), ("flange_rpy_rad", 3), ("base_pose", 4), ("rest_rad", None)):
            values = getattr(self, name)
            if not all(math.isfinite(value) for value in values) or (values and count and len(values) != count):
                raise SettingsError(f"{name} must be empty or hold {count or 'n'} finite numbers, got {values}")
        is_file = self.model.lower().endswith(".urdf")
        if not is_file and self.model not in ARMS:
            raise SettingsError(f"model must be {', '.join(ARMS)} or the path of a .urdf file, got {self.model!r}")
        if is_file and not self.flange_link:
            raise SettingsError(f"flange_link must name the link of {self.model} that carries the tool")
        of_file = ("flange_link", "flange_xyz_m", "flange_rpy_rad") + (("rest_rad",) if self.model == "iiwa" else ())
        given = [] if is_file else [name for name in of_file if getattr(self, name)]
        if given:
            raise SettingsError(f"{', '.join(given)} cannot be changed for the arm {self.model!r}; leave it empty")


@dataclasses.dataclass(frozen=True)
class JointFriction:
    """Friction that the drives do not compensate. Each seed draws its own values.

    Attributes:
        coulomb_nm: (n) residual dry friction of each joint, about 0.1 % of the rated torque: with it the iiwa tracks
            within 0.5 mm at 0.01 m/s, as the paper reports for the real one.
        viscous_nms: (n) damping of each joint in N m s/rad.
        variation: relative variation (uniform, +-) of both between seeds.
        torque_gain_sd: standard deviation of each torque sensor's gain about 1.
    """

    coulomb_nm: tuple[float, ...]
    viscous_nms: tuple[float, ...]
    variation: float = 0.3
    torque_gain_sd: float = 0.003

    def __post_init__(self) -> None:
        for name in ("coulomb_nm", "viscous_nms"):
            values = getattr(self, name)
            if len(values) != len(self.coulomb_nm) or not all(f >= 0 and math.isfinite(f) for f in values):
                raise SettingsError(f"{name} must hold one finite value >= 0 for each joint, got {values}")
        if not 0 <= self.variation < 1:
            raise SettingsError(f"variation must lie in [0, 1), got {self.variation}")
        if not 0 <= self.torque_gain_sd <= 0.1:
            raise SettingsError(f"torque_gain_sd must lie in [0, 0.1], got {self.torque_gain_sd}")

    @classmethod
    def of(cls, limits: JointLimits) -> "JointFriction":
        """Return the same fractions of the rated torques as for the iiwa."""
        coulomb = tuple(0.001 * torque for torque in limits.torque_nm)
        return cls(coulomb, tuple(2.5 * torque for torque in coulomb))


class InverseKinematics(Protocol):
    """Joint positions for poses of the tool."""

    def inverse(self, poses: Array) -> Array:
        """Return joint positions (N, n), continuous along tool poses (N, 4); raise PlanningError if there are none."""


@dataclasses.dataclass(frozen=True)
class ArmModel:
    """What an arm is, besides its URDF file.

    Attributes:
        urdf: file; a relative path is one of PyBullet's models.
        flange_link, flange_xyz_m, flange_rpy_rad, rest_rad: as in ``ArmSettings``.
        mount: place of the base beside a table of height 0.
        limits: None: those of the URDF file.
        friction: None: ``JointFriction.of`` the limits.
        closed_form: inverse kinematics from mount, length of the tool and its symmetry; None: ``ChainKinematics``.
        recolored: material of the URDF file that is shown in light gray.
    """

    urdf: str
    flange_link: str
    flange_xyz_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    flange_rpy_rad: tuple[float, ...] = (0.0, 0.0, 0.0)
    rest_rad: tuple[float, ...] = ()
    mount: ArmMount = dataclasses.field(default_factory=ArmMount)
    limits: JointLimits | None = None
    friction: JointFriction | None = None
    closed_form: Callable[[ArmMount, float, bool], InverseKinematics] | None = None
    recolored: str = ""

    @classmethod
    def of(cls, settings: ArmSettings) -> "ArmModel":
        """Return the arm that the settings choose."""
        model = ARMS.get(settings.model) or cls(settings.model, settings.flange_link)
        given = {name: getattr(settings, name) for name in ("flange_xyz_m", "flange_rpy_rad", "rest_rad")}
        chosen = {name: values for name, values in given.items() if values}
        mount = ArmMount(*settings.base_pose) if settings.base_pose else model.mount
        return dataclasses.replace(model, mount=mount, **chosen)


ARMS: Mapping[str, ArmModel] = {
    "iiwa": ArmModel(
        "kuka_iiwa/model.urdf",
        "lbr_iiwa_link_7",
        flange_xyz_m=(0.0, 0.0, 0.045),
        limits=IIWA14_LIMITS,
        friction=JointFriction((0.2, 0.2, 0.12, 0.12, 0.08, 0.04, 0.04), (0.5, 0.5, 0.3, 0.3, 0.2, 0.1, 0.1)),
        closed_form=IiwaKinematics,
        recolored="Blue",
    ),
    "panda": ArmModel(
        "franka_panda/panda.urdf",
        "panda_link7",
        flange_xyz_m=(0.0, 0.0, 0.107),
        flange_rpy_rad=(0.0, 0.0, math.pi / 4),
        rest_rad=(0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4),
        mount=ArmMount(base_y_m=0.6, base_z_m=0.0),
    ),
}
"""Arms by name. The mount of the iiwa is justified in ``world``; that of the panda has the largest product of smallest
manipulability (0.046) and smallest relative margin to a joint limit (41 %) over the same poses with a yaw of at most
1.5 rad, among base heights of -0.1 to 0.3 m and distances of 0.4 to 0.65 m. Its posture of rest is Franka's `ready`."""
