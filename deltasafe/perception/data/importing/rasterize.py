"""Outlines and run lengths drawn as pixels, each as the format's own tool draws them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from deltasafe.perception.data.importing.source import numbers

Mask = NDArray[np.bool_]
MAX_COORDINATE_PX = 1e5
"""pycocotools allocates memory in proportion to the length of an outline."""


def polygons(outlines: Sequence[Any], height: int, width: int) -> Mask:
    """Fill outlines (N, 2) as COCO does, which CVAT and Label Studio share: a pixel belongs to it by its center.

    Raises:
        ValueError: an outline has fewer than three points, or lies far outside the image.
    """
    from pycocotools import mask as coco_mask

    flat = []
    for outline in outlines:
        points = numbers(outline)
        if len(points) < 3:
            raise ValueError(f"an outline has {len(points)} points; it needs three")
        if np.abs(points).max() > MAX_COORDINATE_PX:
            raise ValueError("an outline lies far outside the image")
        flat.append(points.ravel().tolist())
    if not flat:
        raise ValueError("there is no outline")
    packed = coco_mask.merge(coco_mask.frPyObjects(flat, height, width))["counts"]
    return _runs(_unpacked(packed), height * width).reshape(width, height).T


def outlined(kind: str, points: Any, height: int, width: int) -> Mask:
    """Fill a polygon, rectangle or circle as labelme does: with Pillow, pixels under the outline included.

    Raises:
        ValueError: the number of points does not fit the kind.
    """
    xy = numbers(points)
    needed = {"polygon": 3, "oriented_rectangle": 4, "rectangle": 2, "circle": 2}[kind]
    if len(xy) < needed or (kind != "polygon" and len(xy) != needed):
        raise ValueError(f"a {kind} has {len(xy)} points; it needs {needed}")
    if np.abs(xy).max() > MAX_COORDINATE_PX:
        raise ValueError(f"a {kind} lies far outside the image")
    canvas = Image.new("L", (width, height))
    draw = ImageDraw.Draw(canvas)
    if kind == "circle":
        radius = float(np.hypot(*(xy[1] - xy[0])))
        draw.ellipse([*(xy[0] - radius), *(xy[0] + radius)], fill=1, outline=1)
    elif kind == "rectangle":
        draw.rectangle([*xy.min(axis=0), *xy.max(axis=0)], fill=1, outline=1)
    else:
        draw.polygon([(float(x), float(y)) for x, y in xy], fill=1, outline=1)
    return np.asarray(canvas, bool)


def ellipse(center: tuple[float, float], radii: tuple[float, float], angle_rad: float, height: int, width: int) -> Mask:
    """Return the pixels whose centers lie in an ellipse, turned clockwise in the image by ``angle_rad``."""
    y, x = np.mgrid[:height, :width] + 0.5
    dx, dy = x - center[0], y - center[1]
    along = dx * np.cos(angle_rad) + dy * np.sin(angle_rad)
    across = dy * np.cos(angle_rad) - dx * np.sin(angle_rad)
    return np.asarray((along * radii[1]) ** 2 + (across * radii[0]) ** 2 <= (radii[0] * radii[1]) ** 2)


def run_lengths(record: Mapping[str, Any], height: int, width: int) -> Mask:
    """Decode COCO's run lengths, compressed (a string) or not (a list); they run down the columns.

    Raises:
        ValueError: they are not of the image's size.
    """
    if list(record["size"]) != [height, width]:
        raise ValueError(f"the run lengths are for {record['size'][1]} x {record['size'][0]}, not {width} x {height}")
    counts = record["counts"]
    lengths = _unpacked(counts.encode()) if isinstance(counts, str) else counts
    return _runs(lengths, height * width).reshape(width, height).T


def row_runs(counts: Sequence[int], box: tuple[int, int, int, int], height: int, width: int) -> Mask:
    """Decode CVAT's run lengths, which run along the rows of a box (left, top, width, height).

    Raises:
        ValueError: they do not fill the box, or it leaves the image.
    """
    left, top, across, down = box
    if left < 0 or top < 0 or left + across > width or top + down > height:
        raise ValueError(f"the box {box} of a mask leaves the image of {width} x {height}")
    mask = np.zeros((height, width), bool)
    mask[top : top + down, left : left + across] = _runs(counts, across * down).reshape(down, across)
    return mask


def brush_alpha(data: Sequence[int], height: int, width: int) -> NDArray[np.uint8]:
    """Decode the alpha channel of a brush stroke of Label Studio, which packs RGBA by the library rle-pack.

    Format (bits, most significant first): number of values (32), bits of a value - 1 (5), four sizes - 1 (4 each); then
    blocks of a flag (1), an index of a size (2), a length - 1 (of that size), and one value if the flag is set, else
    one value for each place.

    Raises:
        ValueError: the data are truncated, or not for an image of this size.
    """
    bits = np.unpackbits(numbers(data, 1).astype(np.uint8).ravel())
    position = 0

    def read(n_bits: int) -> int:
        nonlocal position
        position += n_bits
        if position > bits.size:
            raise ValueError("the brush stroke is truncated")
        return int("".join(map(str, bits[position - n_bits : position].tolist())), 2)

    n_values, value_bits = read(32), read(5) + 1
    if n_values != 4 * height * width or value_bits != 8:
        raise ValueError(f"the brush stroke has {n_values} values of {value_bits} bits; {width} x {height} need RGBA")
    length_bits = [read(4) + 1 for _ in range(4)]
    values, done = np.empty(n_values, np.uint8), 0
    while done < n_values:
        repeats = read(1)
        end = done + 1 + read(length_bits[read(2)])
        if end > n_values:
            raise ValueError("the brush stroke is longer than its image")
        if repeats:
            values[done:end] = read(value_bits)
        else:
            start, position = position, position + value_bits * (end - done)
            if position > bits.size:
                raise ValueError("the brush stroke is truncated")
            values[done:end] = np.packbits(bits[start:position])
        done = end
    return values.reshape(height, width, 4)[..., 3]


def _unpacked(data: bytes) -> list[int]:
    """Decode COCO's compressed run lengths; its own decoder cannot make an array without a copy, as numpy 2 wants.

    Format: characters from "0", each with five bits of a signed number (the least significant first) and a bit that
    says whether more follow; from the fourth run on, the difference to the last but one run.
    """
    lengths: list[int] = []
    value = n_bits = 0
    for character in data:
        bits = character - ord("0")
        value |= (bits & 31) << n_bits
        n_bits += 5
        if not bits & 32:
            value -= (bits >> 4 & 1) << n_bits
            lengths.append(value + (lengths[-2] if len(lengths) > 2 else 0))
            value = n_bits = 0
    return lengths


def _runs(counts: Sequence[int], total: int) -> Mask:
    lengths = numbers(counts, 1).ravel()
    if (lengths < 0).any() or (lengths % 1).any() or lengths.sum() != total:
        raise ValueError(f"the run lengths sum to {lengths.sum():g}, not to {total} pixels")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths.astype(np.int64))
