"""Contact sheets: predictions of all scenes, and tiled images."""

import pathlib
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_file
from deltasafe.perception.inference.occupancy_overlay import occupancy_overlay
from deltasafe.scene import LoggedScene
from deltasafe.trials.occupancy_fields import load_p_occupied


def overview(
    scenes: Sequence[LoggedScene], fields: pathlib.Path, delta: float, destination: pathlib.Path, columns: int = 5
) -> pathlib.Path:
    """Write the prediction of every scene to one JPEG; return its path.

    Args:
        fields: folder that `deltasafe.trials.occupancy_fields.write_fields` wrote.
        delta: level of the drawn contour.
    """
    tiles = []
    for scene in scenes:
        overlay = occupancy_overlay(read_rgb(scene.image_path), load_p_occupied(fields, scene.id), delta)
        tile = cv2.resize(overlay, (320, 240), interpolation=cv2.INTER_AREA)
        cv2.putText(tile, scene.id, (8, 230), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(tile, scene.id, (8, 230), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    _write_sheet(tiles, columns, destination, ground=0, quality=85)
    return destination


def tile_pictures(pictures: Sequence[pathlib.Path], destination: pathlib.Path, columns: int = 3) -> None:
    """Write images of one size as tiles, 640 pixels wide, to one JPEG."""
    tiles = []
    for path in pictures:
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_COLOR_RGB)
        if image is None:
            raise DataError(path, "is not an image; make it again")
        height = round(640 * image.shape[0] / image.shape[1])
        tiles.append(cv2.resize(image, (640, height), interpolation=cv2.INTER_AREA))
    _write_sheet(tiles, columns, destination, ground=255, quality=80)


def _write_sheet(
    tiles: Sequence[NDArray[Any]], columns: int, destination: pathlib.Path, *, ground: int, quality: int
) -> None:
    """Write tiles (H, W, 3) of one width, row by row, on a gray background."""
    height, width = max(len(tile) for tile in tiles), tiles[0].shape[1]
    columns = min(columns, len(tiles))
    sheet = np.full((-(-len(tiles) // columns) * height, columns * width, 3), ground, np.uint8)
    for index, tile in enumerate(tiles):
        row, column = divmod(index, columns)
        sheet[row * height :][: len(tile), column * width :][:, :width] = tile
    with atomic_file(destination) as temporary:
        temporary.write_bytes(cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes())
