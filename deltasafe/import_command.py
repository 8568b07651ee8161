"""The command `deltasafe import`: a scene folder from a log."""

import argparse
import math
import pathlib
from typing import Any

from deltasafe.camera_commands import add_image_kind
from deltasafe.errors import SettingsError


def add_import_command(commands: Any) -> None:
    """Add the parser of ``import`` to those of ``deltasafe``."""
    parser = commands.add_parser("import", help="convert a log, MCAP or a ROS 2 bag, to a scene folder")
    parser.set_defaults(run=_import)
    path, pose = pathlib.Path, ("X", "Y", "Z", "YAW")
    parser.add_argument("log", type=path, help="file (.mcap, .db3), or folder that ros2 bag record wrote")
    parser.add_argument("folder", type=path, help="folder to write")
    parser.add_argument("--image-topic", metavar="TOPIC", help="topic of the image, if there are several")
    parser.add_argument("--calibration-topic", metavar="TOPIC", help="topic of its calibration, if there are several")
    parser.add_argument("--camera", type=path, metavar="FILE", help="calibration or camera file, instead of the log's")
    add_image_kind(parser)
    parser.add_argument("--camera-frame", metavar="FRAME", help="optical frame, instead of the image's frame_id")
    parser.add_argument("--world-frame", default="world", metavar="FRAME", help="world frame, z up (default: world)")
    parser.add_argument(
        "--at", type=float, default=0.0, metavar="SECONDS", help="use the first image this long after the first"
    )
    parser.add_argument("--table-z", type=float, metavar="M", help="height of the table in the world frame")
    parser.add_argument("--hand-height", type=float, metavar="M", help="height of the hand above the table")
    for name in ("start", "goal"):
        parser.add_argument(f"--{name}", type=float, nargs=4, metavar=pose, help="in the world frame; m and degrees")
        parser.add_argument(f"--{name}-topic", metavar="TOPIC", help=f"topic of the {name}, instead of the numbers")
    parser.add_argument("--id", help="name of the scene (default: that of the folder)")


def _import(options: argparse.Namespace) -> None:
    from deltasafe.cameras.calibration_files import read_camera
    from deltasafe.geometry import Pose
    from deltasafe.interchange import ImportOptions, import_scene

    tasks: dict[str, Pose | str | None] = {}
    for name in ("start", "goal"):
        numbers, tasks[name] = getattr(options, name), getattr(options, f"{name}_topic")
        if numbers is not None:
            if tasks[name] is not None:
                raise SettingsError(f"give --{name} or --{name}-topic, not both")
            x_m, y_m, z_m, yaw_degrees = numbers
            tasks[name] = Pose(x_m, y_m, z_m, math.radians(yaw_degrees))
    given = ImportOptions(
        image_topic=options.image_topic,
        calibration_topic=options.calibration_topic,
        camera=None if options.camera is None else read_camera(options.camera, options.image_kind),
        image_kind=options.image_kind,
        camera_frame=options.camera_frame,
        world_frame=options.world_frame,
        image_after_s=options.at,
        table_z_m=options.table_z,
        hand_height_m=options.hand_height,
        scene_id=options.id,
        **tasks,
    )
    print(f"{options.folder}: {import_scene(options.log, options.folder, given).id}")
    print(f"see what it means: deltasafe scene check {options.folder} -o understood.png")
