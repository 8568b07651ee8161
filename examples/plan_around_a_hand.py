"""From an image to a motion around the hand in it: probability, field, delta-safe path, speed.

python plan_around_a_hand.py ENSEMBLE SCENE [-o FOLDER]
"""

import argparse
import dataclasses
import pathlib
import sys

from deltasafe import load_ensemble
from deltasafe.errors import DeltasafeError
from deltasafe.perception.calibration.delta_support import require_supported_delta
from deltasafe.perception.data.labeled_images import read_rgb
from deltasafe.planning import plan_motion
from deltasafe.presets import PRESETS
from deltasafe.scene import ImageStamp, LoggedScene, grid_from_image
from deltasafe.trials.motion_figure import plan_over_image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ensemble", help="folder ensemble-..., as it was frozen")
    parser.add_argument("scene", help="folder with an image and its scene.json (camera, table, start, goal)")
    parser.add_argument("-o", "--output", type=pathlib.Path, default="plan", help="folder to write (%(default)s)")
    parser.add_argument("--delta", type=float, default=0.05, help="tolerated P(occupied) at each point (%(default)s)")
    options = parser.parse_args()

    ensemble = load_ensemble(options.ensemble)
    require_supported_delta(options.delta, ensemble.calibration)
    preset = PRESETS["default"]
    settings = dataclasses.replace(preset.motion, delta=options.delta)

    scene = LoggedScene.load(options.scene)
    rgb = read_rgb(scene.image_path)
    p_occupied = ensemble.p_occupied(rgb)
    field = grid_from_image(p_occupied, scene.camera, scene.table_z_m, scene.hand_height_m, preset.field)
    motion = plan_motion(field, scene.start, scene.goal, settings, image_stamp=ImageStamp.of(rgb))

    motion.save(options.output)
    picture = options.output / "plan.png"
    plan_over_image(rgb, p_occupied, scene.camera, motion, motion.body, settings.delta, picture, scene.table_z_m)
    if motion.trajectory is None or motion.profile is None:
        sys.exit(f"{scene.id}: no motion is safe at delta = {settings.delta:g}: {motion.reason}")
    profile = motion.profile
    print(f"{scene.id}: a delta-safe motion, at every point p_occupied <= {settings.delta:g}")
    print(f"  {1000 * profile.arc_length_m[-1]:.0f} mm in {motion.trajectory.duration_s:.1f} s")
    print(f"  clearance {1000 * profile.clearance_m.min():.1f} mm or more")
    print(f"  up to {1000 * profile.speed_mps.max():.0f} mm/s, slower where it is close")
    print(f"  {picture}, reference at the controller's rate in {options.output / 'motion.npz'}")


if __name__ == "__main__":
    try:
        main()
    except DeltasafeError as error:
        sys.exit(f"plan_around_a_hand: {error}")
