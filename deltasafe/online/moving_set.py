"""The unsafe set of an image as it grows with time: a clearance that shrinks while the image ages."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning import DistanceField, ToolBody, TrackingBound, body_clearance_m, segment_test
from deltasafe.scene import OccupancyGrid

Array = NDArray[np.float64]

NO_TABLE_M = -1e6
"""Height of the table in the field of the hand: the table does not move, and is tested apart."""


@dataclasses.dataclass(frozen=True)
class Refusal:
    """Where a timed motion leaves its clearance: time on the control's clock, and what is missing in meters."""

    time_s: float
    missing_m: float


class MovingSet:
    """What may be occupied at a time after an image was captured.

    The hand lies in {p_occupied > delta} dilated by the margin r when the image is captured. At time t it lies within
    v_hand (t - captured_s) of that set, in any direction. Space beside the camera's view grows the same way, because a
    hand may enter from there. The table does not grow.

    Args:
        grid: P(occupied) of the image.
        delta: level of the unsafe set.
        captured_s: when the image was captured, on the control's clock.
        v_hand_mps: assumed maximum speed of the hand.
        margin_m: r.
        body: the tool.
        reach_m: distances are exact up to here, and lower bounds beyond.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        delta: float,
        captured_s: float,
        v_hand_mps: float,
        margin_m: float,
        body: ToolBody,
        reach_m: float,
    ) -> None:
        self.captured_s, self.v_hand_mps, self.margin_m, self.body = captured_s, v_hand_mps, margin_m, body
        self.field = DistanceField.build(grid.dilated(delta, margin_m), delta, reach_m)
        arrays = self.field.arrays._replace(table_z_m=NO_TABLE_M)
        self._test = segment_test(dataclasses.replace(self.field, arrays=arrays), body, 0.0)

    def needed_m(self, time_s: Array, speed_mps: Array, tracking: TrackingBound, v_min_mps: float) -> Array:
        """Clearance (N,) from the set of the image that a pose needs at a time and a speed of the fastest point."""
        return self.v_hand_mps * (time_s - self.captured_s) + tracking.error_m(np.maximum(speed_mps, v_min_mps))

    def clearance_m(self, poses: Array) -> Array:
        """Lower bound (N,) of the distance from the tool at poses (N, 4) to the set of the image, without the table."""
        return body_clearance_m(self._test, poses)

    def refusal(
        self, time_s: Array, poses: Array, speed_mps: Array, tracking: TrackingBound, v_min_mps: float
    ) -> Refusal | None:
        """Return the first piece of a timed motion that is not proven clear of the growing set, or None.

        Between two samples the tool moves along the straight segment, and its clearance is 1-Lipschitz in the motion of
        its fastest point: on the whole segment it is at least (d_i + d_{i+1} - motion) / 2. The clearance needed there
        is at most that at the later time and the larger speed. So the test is continuous in time.

        Args:
            time_s: (N,) increasing, N >= 2.
            poses: (N, 4) reference of the tool.
            speed_mps: (N,) largest reference speed of any point of the tool beside each sample.
        """
        clear_m = self.clearance_m(poses)
        table_m = poses[:, 2] - self.body.params.half_thickness_m - self.field.arrays.table_z_m
        steps = np.diff(poses, axis=0)
        motion_m = np.linalg.norm(steps[:, :3], axis=1) + self.body.rho_max_m * np.abs(steps[:, 3])
        least_m = (clear_m[:-1] + clear_m[1:] - motion_m) / 2
        fastest = np.maximum(speed_mps[:-1], speed_mps[1:])
        spare_m = least_m - self.needed_m(time_s[1:], fastest, tracking, v_min_mps)
        above_m = np.minimum(table_m[:-1], table_m[1:]) - tracking.error_m(np.maximum(fastest, v_min_mps))
        spare_m = np.minimum(spare_m, above_m)
        bad = np.flatnonzero(~(spare_m >= 0))  # NaN is refused
        if not len(bad):
            return None
        return Refusal(float(time_s[1 + bad[0]]), float(-spare_m[bad].min()))

    def grown(self, age_s: float) -> DistanceField:
        """Return the field of the set at an age of the image, the table unchanged: for the search of a path.

        Voxels whose centers are within v_hand ``age_s`` and half a voxel of the set are unsafe; rounding and discrete
        distances matter to the search alone, because every accepted motion passes ``refusal``.
        """
        lattice, grid = self.field.arrays.lattice, self.field.grid
        reach_m = self.v_hand_mps * age_s
        if reach_m == 0.0:
            return self.field
        near = self.field.arrays.squared_distance <= (2 * reach_m / lattice.voxel_m + 1) ** 2
        height = grid.p_occupied.shape[2] + int(np.ceil(reach_m / lattice.voxel_m))
        p_occupied = near[1:-1, 1:-1, :height].astype(np.float32)
        return DistanceField.build(OccupancyGrid(p_occupied, grid.origin_m, grid.voxel_m), self.field.delta)
