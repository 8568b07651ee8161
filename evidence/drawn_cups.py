"""Photographs of a coffee cup on a table, drawn by OpenCV from a known camera, with the polygon that labels the cup."""

import dataclasses
import json
import math
import pathlib

import cv2
import numpy as np
from numpy.typing import NDArray

from evidence.board_images import Lens, View, look_at

Array = NDArray[np.float64]

_CORNERS = 48
_CUP_RGB = ((190, 45, 40), (200, 60, 35), (175, 35, 55))


@dataclasses.dataclass(frozen=True)
class Cup:
    """A cup that stands on the table z = 0.

    Attributes:
        x_m, y_m: of its axis.
        radius_m, height_m: of its cylinder.
        handle_rad: direction of the handle.
    """

    x_m: float
    y_m: float
    radius_m: float = 0.04
    height_m: float = 0.085
    handle_rad: float = 0.6

    def circle(self, z_m: float, radius_m: float) -> Array:
        """Return (N, 3) points of a circle around the axis."""
        angle = np.linspace(0, 2 * np.pi, _CORNERS, endpoint=False)
        x, y = self.x_m + radius_m * np.cos(angle), self.y_m + radius_m * np.sin(angle)
        return np.stack([x, y, np.full(_CORNERS, z_m)], axis=1)

    def handle(self) -> Array:
        """Return (N, 3) points on the center line of the handle, a half circle in a vertical plane."""
        angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
        reach_m = self.radius_m - 0.004 + 0.026 * np.cos(angle)
        x, y = self.x_m + reach_m * math.cos(self.handle_rad), self.y_m + reach_m * math.sin(self.handle_rad)
        return np.stack([x, y, 0.5 * self.height_m + 0.026 * np.sin(angle)], axis=1)


def draw_cup(
    cup: Cup, lens: Lens, view: View, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], list[NDArray[np.int32]]]:
    """Draw a photograph (H, W, 3) RGB of the cup; return it with the polygons (N, 2) in pixels of its outline."""
    width, height = lens.size
    image = _table(width, height, rng)
    mask = np.zeros((height, width), np.uint8)

    def pixels(points_m: Array) -> NDArray[np.int32]:
        turn, to_camera = cv2.Rodrigues(view.rotation.T)[0], view.rotation.T
        uv, _ = cv2.projectPoints(points_m[:, None], turn, -to_camera @ view.position_m, lens.matrix, lens.distortion)
        return np.round(uv.reshape(-1, 2)).astype(np.int32)

    top, foot = pixels(cup.circle(cup.height_m, cup.radius_m)), pixels(cup.circle(0.0, 0.85 * cup.radius_m))
    body, color = cv2.convexHull(np.concatenate([top, foot])), np.array(_CUP_RGB[int(rng.integers(len(_CUP_RGB)))])
    thick_px = max(2, round(0.009 * lens.matrix[0, 0] / float(view.position_m[2])))
    shadow = np.zeros((height, width), np.float32)
    cv2.fillConvexPoly(shadow, body + np.int32(thick_px), 1.0)
    image *= (1 - 0.4 * cv2.GaussianBlur(shadow, (0, 0), thick_px))[..., None]
    for canvas, paint in ((image, (0.8 * color).tolist()), (mask, 255)):
        cv2.polylines(canvas, [pixels(cup.handle())], False, paint, thick_px, cv2.LINE_8)
        cv2.fillConvexPoly(canvas, body, paint)
    cv2.fillConvexPoly(image, top, color.tolist())
    cv2.fillConvexPoly(image, pixels(cup.circle(cup.height_m - 0.01, 0.87 * cup.radius_m)), (50, 32, 22))
    noisy = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 4, image.shape)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.clip(noisy, 0, 255).astype(np.uint8), [
        np.asarray(outline, np.int32).reshape(-1, 2) for outline in outlines
    ]


def write_coco(folder: pathlib.Path, count: int, seed: int, size: tuple[int, int] = (320, 240)) -> pathlib.Path:
    """Draw ``count`` cups from random cameras, and label them as COCO JSON; return the JSON file."""
    rng, images, annotations = np.random.default_rng(seed), [], []
    folder.mkdir(parents=True)
    for number in range(count):
        target_m, focal_px = np.append(rng.uniform(-0.05, 0.05, 2), 0.0), size[0] * rng.uniform(1.0, 1.4)
        lens = Lens(size, np.array([[focal_px, 0, size[0] / 2], [0, focal_px, size[1] / 2], [0, 0, 1]]), np.zeros(5))
        view = look_at(target_m, rng.uniform(0.4, 0.65), rng.uniform(0, 0.35), *rng.uniform(0, 2 * np.pi, 2))
        x_m, y_m, radius_m, height_m, handle_rad = rng.uniform(
            (-0.05, -0.05, 0.035, 0.07, 0.0), (0.05, 0.05, 0.045, 0.1, 2 * np.pi)
        )
        cup = Cup(x_m, y_m, radius_m, height_m, handle_rad)
        photo, outlines = draw_cup(cup, lens, view, rng)
        name = f"cup_{number:03d}.png"
        (folder / name).write_bytes(cv2.imencode(".png", photo[..., ::-1])[1].tobytes())
        images.append({"id": number, "file_name": name, "width": size[0], "height": size[1]})
        polygons = [(outline + 0.5).ravel().tolist() for outline in outlines]
        annotations.append({"id": number, "image_id": number, "category_id": 1, "segmentation": polygons, "iscrowd": 0})
    labels = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "coffee cup"}]}
    (folder / "instances.json").write_text(json.dumps(labels), encoding="utf-8")
    return folder / "instances.json"


def write_backgrounds(folder: pathlib.Path, count: int, seed: int) -> pathlib.Path:
    """Draw tables without a cup; return the folder."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True)
    for number in range(count):
        picture = np.clip(_table(320, 240, rng), 0, 255).astype(np.uint8)
        (folder / f"table_{number}.png").write_bytes(cv2.imencode(".png", picture[..., ::-1])[1].tobytes())
    return folder


def _table(width: int, height: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw a table: a gray or brown surface with grain, uneven light, and some sheets of paper."""
    base = rng.uniform(70, 190) * np.array([1.0, rng.uniform(0.85, 1.0), rng.uniform(0.7, 1.0)])
    grain = cv2.resize(rng.normal(0, 9, (height // 3, width // 16)).astype(np.float32), (width, height))
    left, right, top, bottom = rng.uniform(0.75, 1.1, 4)
    light = np.linspace(left, right, width) * np.linspace(top, bottom, height)[:, None]
    image = ((base + grain[..., None]) * light[..., None]).astype(np.float32)
    for _ in range(int(rng.integers(0, 3))):
        middle, turn_deg = rng.uniform(0, 1, 2) * (width, height), float(rng.uniform(0, 180))
        corners = cv2.boxPoints((middle.tolist(), (0.3 * width, 0.2 * width), turn_deg))
        cv2.fillConvexPoly(image, np.round(corners).astype(np.int32), rng.uniform(60, 250, 3).tolist())
    return image
