"""Film of an execution from its recorded joint positions: an oblique view beside the view of the logged camera."""

import pathlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm_view import ArmView, Viewpoint
from deltasafe.execution.recording import PHASES, Execution
from deltasafe.execution.workcell import Workcell
from deltasafe.io.storage import atomic_file
from deltasafe.scene.camera import Camera

Array = NDArray[np.float64]

_EYE_M, _TARGET_M = (0.50, -0.52, 0.42), (0.0, 0.08, 0.20)
_CUT_ABOVE_TABLE_M = 0.24
_REFERENCE_RGB, _TRACE_RGB = (150, 150, 160), (20, 110, 220)
_TEXT_RGB, _BAR_RGB = (235, 235, 235), (32, 34, 38)
_BAR_PX = 26
_FRAMES_PER_S = 10


def save_film(
    destination: str | pathlib.Path,
    execution: Execution,
    camera: Camera,
    cell: Workcell,
    *,
    seconds: float = 7.0,
    view_width: int = 400,
    thing: str = "hand",
) -> None:
    """Write a film of ``seconds`` as an animated GIF, atomically; both views are ``view_width`` pixels wide.

    ``cell`` is the workcell of the execution, and ``thing`` the display name of the obstacle in it.

    Raises:
        SettingsError: the destination does not end in .gif.
    """
    from PIL import GifImagePlugin, Image

    destination = pathlib.Path(destination)
    if destination.suffix.lower() != ".gif":
        raise SettingsError(f"a film is an animated GIF and must end in .gif, got {destination.name}")
    distances = _distances(execution, thing)
    frames = _frames(execution, camera, cell, (seconds, view_width), distances)
    middle = np.concatenate([frames[0], frames[len(frames) // 2], frames[-1]])
    palette = Image.fromarray(middle).quantize(128, dither=Image.Dither.NONE)
    images = [Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    with atomic_file(destination) as temporary:
        images[0].save(
            temporary,
            format=GifImagePlugin.GifImageFile.format,
            save_all=True,
            append_images=images[1:],
            duration=round(1000 / _FRAMES_PER_S),
            loop=0,
            optimize=False,
        )


def _frames(
    execution: Execution, camera: Camera, cell: Workcell, size: tuple[float, int], distances: Sequence[str]
) -> list[NDArray[np.uint8]]:
    """Frames (H, W, 3) uint8: reference in gray, executed path in blue, a line of text below.

    Args:
        size: seconds of the film, and width of a view in pixels.
        distances: text on the distance at each sample.
    """
    seconds, view_width = size
    # the near plane of the camera's view cuts the links away: the arm passes between the camera and the table
    along_axis = -float(camera.world_from_camera_rotation[2, 2])  # 1 for a camera that looks straight down
    near_m = (float(camera.position_m[2]) - cell.table_z_m - _CUT_ABOVE_TABLE_M) * along_axis
    camera_view = Viewpoint.of_camera(camera, view_width, max(near_m, 0.01))
    oblique = Viewpoint.looking_at(np.array(_EYE_M), np.array(_TARGET_M), view_width, camera_view.height)
    count = max(2, round(seconds * _FRAMES_PER_S))
    samples = np.round(np.linspace(0, len(execution.time_s) - 1, count)).astype(int)
    speed_up = float(execution.time_s[-1] / seconds)
    frames = []
    with ArmView(cell, execution.arm) as arm:
        for sample in samples:
            views = [
                _with_paths(arm.render(execution.joint_positions_rad[sample], view), execution, sample, view)
                for view in (oblique, camera_view)
            ]
            frames.append(_captioned(np.concatenate(views, axis=1), execution, sample, speed_up, distances[sample]))
    return frames


def _with_paths(rgb: NDArray[np.uint8], execution: Execution, sample: int, view: Viewpoint) -> NDArray[np.uint8]:
    from PIL import Image, ImageDraw

    image = Image.fromarray(rgb)
    draw = ImageDraw.Draw(image)
    judged = execution.judged
    reference = view.pixels(execution.reference_poses[judged, :3])
    done = view.pixels(execution.tool_positions_m[: sample + 1][judged[: sample + 1]])
    for path, color, width in ((reference, _REFERENCE_RGB, 1), (done, _TRACE_RGB, 2)):
        points = [tuple(point) for point in path[np.isfinite(path).all(axis=1)]]
        if len(points) > 1:
            draw.line(points, fill=color, width=width)
    return np.asarray(image)


def _distances(execution: Execution, thing: str) -> list[str]:
    if not execution.beside_hand:
        return [f"no true {thing}"] * len(execution.time_s)
    return [f"tool to {thing} {distance_m * 1e3:4.0f} mm" for distance_m in execution.tool_to_hand_m]


def _captioned(
    rgb: NDArray[np.uint8], execution: Execution, sample: int, speed_up: float, distance: str
) -> NDArray[np.uint8]:
    from PIL import Image, ImageDraw, ImageFont

    height, width = rgb.shape[:2]
    image = Image.new("RGB", (width, height + _BAR_PX), _BAR_RGB)
    image.paste(Image.fromarray(rgb))
    text = (
        f"{execution.time_s[sample]:5.1f} s (x{speed_up:.1f})   {PHASES[execution.phase[sample]]:<8}   "
        f"{execution.reference_speed_mps[sample] * 1e3:4.0f} mm/s   {distance}"
    )
    if execution.stop_reason and PHASES[execution.phase[sample]] == "stopped":
        text += "   STOPPED by the monitor"
    font = ImageFont.load_default(size=13)
    ImageDraw.Draw(image).text((8, height + 5), text, fill=_TEXT_RGB, font=font)
    return np.asarray(image)
