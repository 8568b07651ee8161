"""Plan, time and verify a motion of the tool among known obstacles, without camera, network or Dagster.

python plan_a_motion.py [OUT]     # the first plan takes a minute longer: the planner is compiled once per machine
"""

import sys

from deltasafe import Cuboid, DeltasafeError, MotionSettings, Pose, Sphere, grid_from_shapes, plan_motion, verify_motion


def main(out: str = "motion") -> None:
    """Plan from one side of two obstacles to the other; write the motion to the folder ``out``."""
    obstacles = [Cuboid((0.0, 0.0, 0.03), (0.02, 0.05, 0.03)), Sphere((0.08, 0.06, 0.02), 0.02)]
    # p_occupied is 1 inside an obstacle and decreases to 0 over 1 cm; the lower face of the grid is the table
    grid = grid_from_shapes(obstacles, 0.01, (-0.2, -0.15, 0.0), (0.2, 0.15, 0.09), voxel_m=0.005)
    motion = plan_motion(grid, Pose(-0.14, 0.0, 0.03), Pose(0.14, 0.0, 0.03, yaw_rad=0.5), MotionSettings(delta=0.05))
    if motion.trajectory is None or motion.profile is None:
        sys.exit(f"no safe motion: {motion.reason}")
    motion.save(out)
    audit = verify_motion(motion, grid)
    print(f"{1000 * motion.profile.arc_length_m[-1]:.0f} mm in {motion.trajectory.duration_s:.1f} s")
    print(f"smallest clearance {1000 * motion.profile.clearance_m.min():.1f} mm")
    print(f"{audit.unsafe_poses} of {audit.poses} audited poses are unsafe; motion written to {out}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2])
    except DeltasafeError as error:
        sys.exit(f"plan_a_motion: {error}")
