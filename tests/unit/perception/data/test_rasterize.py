"""Run lengths and outlines against independent implementations."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from pycocotools import mask as coco_mask

from deltasafe.perception.data.importing import rasterize

MASKS = arrays.arrays(bool, st.tuples(st.integers(1, 40), st.integers(1, 40)))


@settings(deadline=None)
@given(mask=MASKS)
def test_run_lengths_of_pycocotools(mask):
    packed = coco_mask.encode(np.asfortranarray(mask.astype(np.uint8)))
    record = {"size": packed["size"], "counts": packed["counts"].decode()}
    np.testing.assert_array_equal(rasterize.run_lengths(record, *mask.shape), mask)


def test_run_lengths_of_a_large_mask_without_noise():
    """Runs longer than 15 bits, and differences of both signs."""
    mask = np.zeros((700, 900), np.uint8)
    cv2.ellipse(mask, (500, 300), (350, 200), 20, 0, 360, 1, -1)
    packed = coco_mask.encode(np.asfortranarray(mask))
    record = {"size": [700, 900], "counts": packed["counts"].decode()}
    np.testing.assert_array_equal(rasterize.run_lengths(record, 700, 900), mask == 1)


@pytest.mark.parametrize("counts", [[5], [1, 2, -1, 10], [0.5, 11.5], [20], "PPP", "0o", [], "\u00e9"])
def test_run_lengths_that_do_not_fill_the_image_are_refused(counts):
    with pytest.raises(ValueError, match=r"run lengths|finite"):
        rasterize.run_lengths({"size": [3, 4], "counts": counts}, 3, 4)


@settings(deadline=None, max_examples=50)
@given(points=arrays.arrays(float, (3, 2), elements=st.floats(-5, 45)))
def test_polygons_hold_the_pixels_whose_centers_are_well_inside(points):
    mask = rasterize.polygons([points.ravel().tolist()], 40, 40)
    contour = points.astype(np.float32)
    for row, column in np.ndindex(40, 40):
        distance = cv2.pointPolygonTest(contour, (column + 0.5, row + 0.5), True)
        if abs(distance) > 1.0:
            assert mask[row, column] == (distance > 0)


@pytest.mark.parametrize("outline", [[1, 2, 3, 4], [1, 2, 3], [0, 0, 1e9, 0, 0, 5], [0, 0, float("nan"), 1, 2, 3]])
def test_outlines_without_an_area_or_far_outside_are_refused(outline):
    with pytest.raises(ValueError, match=r"point|outside|finite|reshape"):
        rasterize.polygons([outline], 10, 10)


@settings(deadline=None)
@given(values=arrays.arrays(np.uint8, (6, 9, 4)), cut=st.integers(0, 40))
def test_brush_strokes_packed_without_repeats(values, cut):
    """An encoder of one block of literal values, and the same data truncated."""
    flat = values.ravel()
    bits = f"{flat.size:032b}{7:05b}" + "".join(f"{size - 1:04b}" for size in (3, 4, 8, 16))
    bits += f"0{3:02b}{flat.size - 1:016b}" + "".join(f"{value:08b}" for value in flat)
    bits += "0" * (-len(bits) % 8)
    data = [int(bits[i : i + 8], 2) for i in range(0, len(bits), 8)]
    np.testing.assert_array_equal(rasterize.brush_alpha(data, 6, 9), values[..., 3])
    with pytest.raises(ValueError, match="truncated"):
        rasterize.brush_alpha(data[: -2 - cut], 6, 9)
    with pytest.raises(ValueError, match="need RGBA"):
        rasterize.brush_alpha(data, 9, 9)


def test_ellipses_have_their_area_and_turn_clockwise():
    mask = rasterize.ellipse((50.0, 40.0), (30.0, 10.0), np.pi / 6, 100, 100)
    assert abs(mask.sum() - np.pi * 300) < 12
    x, y = 50 + 25 * np.cos(np.pi / 6), 40 + 25 * np.sin(np.pi / 6)
    assert mask[int(y), int(x)], "image y points down, so that a positive angle is clockwise"
