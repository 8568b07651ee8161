"""The commands `deltasafe scene new` and `deltasafe scene check`."""

import argparse
import math
import pathlib
from typing import Any

from deltasafe.camera_commands import add_image_kind


def add_scene_commands(commands: Any) -> None:
    """Add the parsers of ``scene`` to those of ``deltasafe``."""
    scene = commands.add_parser("scene", help="make a scene folder from a photograph, and check one")
    actions = scene.add_subparsers(required=True, metavar="ACTION")
    path, pose = pathlib.Path, ("X", "Y", "Z", "YAW")

    new = actions.add_parser(
        "new",
        help="write a scene folder from an image, its camera and a task",
        description="Write a scene folder, with a picture of what was understood. Lengths are in meters in the world "
        "frame (z up), YAW is in degrees.",
    )
    new.set_defaults(run=_new)
    new.add_argument("folder", type=path, help="folder to write; its name is the name of the scene")
    new.add_argument("--image", type=path, required=True, help="photograph as the camera takes it")
    new.add_argument(
        "--camera",
        type=path,
        required=True,
        metavar="FILE",
        help="camera file with a pose (deltasafe camera locate), or the scene.json of another scene",
    )
    new.add_argument("--table-z", type=float, default=0.0, metavar="Z", help="height of the table (default: 0)")
    new.add_argument(
        "--hand-height",
        type=float,
        required=True,
        metavar="H",
        help="of the highest visible point of the hand above the table; space above it counts as free, round up",
    )
    for end, where in (("start", "starts"), ("goal", "ends")):
        text = f"where the center of the tool's disc {where}, above the table, and the direction of its long axis"
        new.add_argument(f"--{end}", type=float, nargs=4, required=True, metavar=pose, help=text)
    new.add_argument("--mask", type=path, metavar="FILE", help="true mask of the hand in the photograph, if known")
    add_image_kind(new)

    check = actions.add_parser("check", help="say what is wrong with a scene folder, and draw what it means")
    check.set_defaults(run=_check)
    check.add_argument("folder", type=path, help="folder with a scene.json")
    check.add_argument("-o", "--output", type=path, metavar="FILE", help="picture to write (.png or .jpg)")


def _new(options: argparse.Namespace) -> None:
    from deltasafe.trials.new_scene import PICTURE, SceneDraft, write_scene

    start, goal = ((*pose[:3], math.radians(pose[3])) for pose in (options.start, options.goal))
    draft = SceneDraft(
        options.image,
        options.camera,
        options.hand_height,
        start,
        goal,
        options.table_z,
        options.mask,
        options.image_kind,
    )
    scene = write_scene(draft, options.folder)
    _print_warnings(scene)
    print(f"{options.folder}: scene {scene.id}, {_truth_of(scene)}")
    print(f"{options.folder / PICTURE}: look at it before you plan; do grid, axes, start and goal lie where you mean?")


def _check(options: argparse.Namespace) -> None:
    from deltasafe.scene import LoggedScene
    from deltasafe.trials.new_scene import scene_warnings
    from deltasafe.trials.occupancy_fields import read_scene_image, read_true_mask
    from deltasafe.trials.scene_picture import draw_scene

    scene = LoggedScene.load(options.folder)
    rgb = read_scene_image(scene)
    read_true_mask(scene, rgb.shape[:2])
    _print_warnings(scene)
    print(f"{options.folder}: scene {scene.id} is usable, {_truth_of(scene)}")
    if options.output is not None:
        draw_scene(rgb, scene, options.output, scene_warnings(scene))
        print(f"{options.output}: what the scene means")


def _truth_of(scene: Any) -> str:
    parts = ((scene.mask_path, "a true mask"), (scene.mesh_path, "a true mesh of the hand"))
    return " and ".join(f"with{'' if path else 'out'} {name}" for path, name in parts)


def _print_warnings(scene: Any) -> None:
    from deltasafe.trials.new_scene import scene_warnings

    for warning in scene_warnings(scene):
        print(f"warning: {warning}")
