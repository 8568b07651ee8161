"""Recording of an execution: arrays over time, stored as one folder."""

import dataclasses
import hashlib
import pathlib
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.execution.arm_models import ArmSettings
from deltasafe.io.arrays import read_npz
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning.body import ToolBody

PHASES = ("approach", "rest", "motion", "settle", "retreat", "stopped")
"""Down onto the start, rest there, the planned motion, rest at the goal, up again; stopped by the monitor."""

UNPLANNED_PHASES = (PHASES.index("approach"), PHASES.index("retreat"))

_FORMAT = 1
COLUMNS: dict[str, tuple[type, int | None]] = {
    "time_s": (np.float64, 0),
    "phase": (np.int8, 0),
    "reference_poses": (np.float64, 4),
    "reference_velocities": (np.float64, 4),
    "tool_positions_m": (np.float64, 3),
    "tool_quaternions": (np.float64, 4),
    "joint_positions_rad": (np.float64, None),
    "torques_nm": (np.float64, None),
    "tool_to_hand_m": (np.float64, 0),
    "arm_to_hand_m": (np.float64, 0),
    "contacts": (np.int32, 0),
}
"""Type and number of columns of each recorded array; 0: one value per sample, None: one column per joint."""

_MAY_BE_INFINITE = ("tool_to_hand_m", "arm_to_hand_m")


@dataclasses.dataclass(frozen=True)
class Execution:
    """A recorded run of N samples.

    Attributes:
        time_s: (N,) since the start of the approach.
        phase: (N,) int8, index into ``PHASES``.
        reference_poses, reference_velocities: (N, 4) x, y, z [m], yaw [rad] and their rates.
        tool_positions_m: (N, 3) measured center of the disc.
        tool_quaternions: (N, 4) measured rotation of the tool, x, y, z, w, without half turns of its mounting.
        joint_positions_rad, torques_nm: (N, n); torques as commanded after saturation.
        tool_to_hand_m, arm_to_hand_m: (N,) distance of the tool, and of the links above it, to the hand's surface;
            0 where they touch, infinite without a hand or without links.
        contacts: (N,) int32, contact points in the simulation since the previous sample. The simulation counts a
            contact 1 mm before the surfaces touch.
        body: the tool.
        seed: of the arm's friction and torque sensor gains.
        stop_reason: why the monitor stopped the arm; empty if it did not.
        arm: which arm executed.
    """

    time_s: NDArray[np.float64]
    phase: NDArray[np.int8]
    reference_poses: NDArray[np.float64]
    reference_velocities: NDArray[np.float64]
    tool_positions_m: NDArray[np.float64]
    tool_quaternions: NDArray[np.float64]
    joint_positions_rad: NDArray[np.float64]
    torques_nm: NDArray[np.float64]
    tool_to_hand_m: NDArray[np.float64]
    arm_to_hand_m: NDArray[np.float64]
    contacts: NDArray[np.int32]
    body: ToolBody
    seed: int
    stop_reason: str = ""
    arm: ArmSettings = dataclasses.field(default_factory=ArmSettings)

    def __post_init__(self) -> None:
        count = len(self.time_s)
        for name, (kind, columns) in COLUMNS.items():
            array: NDArray[Any] = np.array(getattr(self, name), dtype=kind)
            wanted = 1 if columns == 0 else 2
            if array.ndim != wanted or len(array) != count or (columns and array.shape[1] != columns):
                raise SettingsError(f"{name} does not fit {count} samples: shape {array.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if np.isnan(array).any() or (np.isinf(array).any() and name not in _MAY_BE_INFINITE):
                raise SettingsError(f"{name} must be finite")
        if count == 0 or not self.judged.any():
            raise SettingsError("an execution needs at least one sample of its motion")

    @property
    def judged(self) -> NDArray[np.bool_]:
        """(N,) the evaluated samples: from rest at the start to rest at the goal, a stop included."""
        return np.asarray(~np.isin(self.phase, UNPLANNED_PHASES))

    @property
    def completed(self) -> bool:
        """Whether the whole motion was executed."""
        return not self.stop_reason

    @property
    def beside_hand(self) -> bool:
        """Whether a hand was in the simulated world; without one, contacts with it are not judged."""
        return bool(np.isfinite(self.tool_to_hand_m).all())

    @property
    def tool_rotations(self) -> NDArray[np.float64]:
        """(N, 3, 3) world from tool."""
        return rotation_matrices(self.tool_quaternions)

    @property
    def reference_speed_mps(self) -> NDArray[np.float64]:
        """(N,) speed of the reference."""
        return np.asarray(np.linalg.norm(self.reference_velocities[:, :3], axis=1))

    @property
    def rotation_error_rad(self) -> NDArray[np.float64]:
        """(N,) angle between measured rotation and reference, with the tilt of the shaft: at least the yaw error."""
        half = self.reference_poses[:, 3] / 2
        # conjugate(reference) * measured, reference = (0, 0, sin, cos)
        x, y, z, w = self.tool_quaternions.T
        c, s = np.cos(half), np.sin(half)
        vector = np.stack([c * x + s * y, c * y - s * x, c * z - s * w])
        return np.asarray(2 * np.arctan2(np.linalg.norm(vector, axis=0), np.abs(c * w + s * z)))

    @property
    def workspace_error_m(self) -> NDArray[np.float64]:
        """(N,) e_pos + rho_max * e_rotation, an upper bound of the error of any point of the disc (decision 13)."""
        position_error_m = np.linalg.norm(self.tool_positions_m - self.reference_poses[:, :3], axis=1)
        return np.asarray(position_error_m + self.body.rho_max_m * self.rotation_error_rad)

    def digest(self) -> str:
        """SHA-256 of the recording: equal runs have equal digests."""
        other_arm = () if self.arm == ArmSettings() else (self.arm,)  # recordings before there were others stay valid
        state = hashlib.sha256(repr((self.body, self.seed, self.stop_reason, *other_arm)).encode())
        for name in COLUMNS:
            array = getattr(self, name)
            state.update(name.encode() + array.dtype.str.encode() + repr(array.shape).encode())
            state.update(np.ascontiguousarray(array).tobytes())
        return state.hexdigest()

    def save(self, folder: str | pathlib.Path) -> None:
        """Write ``folder`` (execution.json, arrays.npz) atomically; an existing folder is replaced."""
        with atomic_folder(folder) as temporary:
            np.savez_compressed(temporary / "arrays.npz", **{name: getattr(self, name) for name in COLUMNS})
            about = {
                "format": _FORMAT,
                "phases": PHASES,
                "body": dataclasses.asdict(self.body),
                "seed": self.seed,
                "stop_reason": self.stop_reason,
                "arm": dataclasses.asdict(self.arm),
                "digest": self.digest(),
            }
            write_json(temporary / "execution.json", about)

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> Self:
        """Read a folder that ``save`` wrote.

        Raises:
            DataError: a file is missing, damaged, altered, or of another format.
        """
        folder = pathlib.Path(folder)
        about = read_json(folder / "execution.json")
        if not isinstance(about, dict) or about.get("format") != _FORMAT:
            raise DataError(
                folder / "execution.json", f"is not an execution of format {_FORMAT}; execute the motion again"
            )
        path = folder / "arrays.npz"
        stored = read_npz(path)
        try:
            arrays = {name: stored[name] for name in COLUMNS}
            body, arm = from_json(ToolBody, about["body"]), from_json(ArmSettings, about.get("arm", {}))
            execution = cls(**arrays, body=body, seed=about["seed"], stop_reason=about["stop_reason"], arm=arm)
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(folder, f"holds no execution ({error!r}); execute the motion again") from error
        if execution.digest() != about.get("digest"):
            raise DataError(folder, "was altered after it was written; execute the motion again")
        return execution


def rotation_matrices(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrices (..., 3, 3) of unit quaternions (..., 4) given as x, y, z, w."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
