"""Plan a motion around the hand in an image: probability, occupancy grid, delta-safe path, speed.

python plan_around_a_hand.py ENSEMBLE SCENE [-o FOLDER] [--delta 0.05]
"""

import argparse
import pathlib
import sys

from deltasafe import (
    DeltasafeError,
    ImageStamp,
    LoggedScene,
    MotionSettings,
    grid_from_image,
    load_ensemble,
    perception,
    plan_motion,
    plan_over_image,
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ensemble", help="folder ensemble-... of the frozen ensemble")
    parser.add_argument("scene", help="folder with an image and its scene.json (camera, table, start, goal)")
    parser.add_argument("-o", "--output", type=pathlib.Path, default="plan", help="folder to write (%(default)s)")
    parser.add_argument("--delta", type=float, default=0.05, help="largest P(occupied) at each point (%(default)s)")
    options = parser.parse_args()

    ensemble = load_ensemble(options.ensemble)
    perception.require_supported_delta(options.delta, ensemble.calibration)

    scene = LoggedScene.load(options.scene)
    rgb = perception.read_rgb(scene.image_path)
    p_occupied = ensemble.p_occupied(rgb)
    grid = grid_from_image(p_occupied, scene.camera, scene.table_z_m, scene.hand_height_m)
    settings = MotionSettings(delta=options.delta)
    motion = plan_motion(grid, scene.start, scene.goal, settings, image_stamp=ImageStamp.of(rgb))

    motion.save(options.output)
    figure = options.output / "plan.png"
    plan_over_image(rgb, p_occupied, scene.camera, motion, figure, scene.table_z_m)
    if motion.trajectory is None or motion.profile is None:
        sys.exit(f"{scene.id}: no motion is safe at delta = {settings.delta:g}: {motion.reason}")
    profile = motion.profile
    print(f"{scene.id}: a delta-safe motion, p_occupied <= {settings.delta:g} at every point")
    print(f"  {1000 * profile.arc_length_m[-1]:.0f} mm in {motion.trajectory.duration_s:.1f} s")
    print(f"  smallest clearance {1000 * profile.clearance_m.min():.1f} mm")
    print(f"  largest speed {1000 * profile.speed_mps.max():.0f} mm/s, slower at small clearance")
    print(f"  {figure}; trajectory at the controller's rate in {options.output / 'motion.npz'}")


if __name__ == "__main__":
    try:
        main()
    except DeltasafeError as error:
        sys.exit(f"plan_around_a_hand: {error}")
