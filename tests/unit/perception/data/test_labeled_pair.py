"""Image and mask are both upright, whichever of the two pictures the mask was drawn on."""

import json
import pathlib

import numpy as np
import pytest
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.perception.data.labeled_images import LabeledImageSet

EXIF_ORIENTATION = 0x0112
# how Pillow turns upright pixels into the ones that a camera stores; the inverse of what viewers do
STORED = {
    1: None,
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}


def photograph(folder: pathlib.Path, orientation: int, drawn_on: str, size: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Write a set of one photograph; return it and its mask as viewers show them."""
    width, height = size
    rgb = np.random.default_rng(orientation).integers(0, 256, (height, width, 3), dtype=np.uint8)
    mask = np.zeros((height, width), np.uint8)
    mask[1 : height // 2, 2 : width // 3] = 255
    exif = Image.Exif()
    exif[EXIF_ORIENTATION] = orientation
    turn = STORED[orientation]
    stored = [
        Image.fromarray(pixels) if turn is None else Image.fromarray(pixels).transpose(turn) for pixels in (rgb, mask)
    ]
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    stored[0].save(folder / "images" / "a.png", exif=exif)
    (stored[1] if drawn_on == "stored" else Image.fromarray(mask)).save(folder / "masks" / "a.png")
    return rgb, mask // 255


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("drawn_on", ["upright", "stored"])
@pytest.mark.parametrize("size", [(30, 20), (20, 30), (24, 24)])
@pytest.mark.parametrize("told", [False, True])
def test_pair_is_upright_if_size_or_option_tells(tmp_path, orientation: int, drawn_on: str, size, told: bool) -> None:
    rgb, mask = photograph(tmp_path, orientation, drawn_on, size)
    if told:
        (tmp_path / "dataset.json").write_text(json.dumps({"masks_drawn_on": drawn_on}))
    size_tells = orientation == 1 or (orientation >= 5 and size[0] != size[1])
    if not (told or size_tells):
        with pytest.raises(DataError, match=f"EXIF orientation {orientation}.*dataset.json") as caught:
            LabeledImageSet.load(tmp_path)
        assert caught.value.path == tmp_path / "images" / "a.png"
        return
    found_rgb, found_mask = LabeledImageSet.load(tmp_path).read(0)
    np.testing.assert_array_equal(found_rgb, rgb)
    np.testing.assert_array_equal(found_mask, mask)


def test_remedy_of_the_message_works_when_it_is_pasted(tmp_path: pathlib.Path) -> None:
    _, mask = photograph(tmp_path, 3, "stored", (30, 20))
    with pytest.raises(DataError) as caught:
        LabeledImageSet.load(tmp_path)
    option = str(caught.value).split("write ")[1].split(" into the file ")
    pathlib.Path(option[1].split(" if ")[0]).write_text(option[0].replace("upright", "stored"))
    np.testing.assert_array_equal(LabeledImageSet.load(tmp_path).read(0)[1], mask)


def test_set_digest_does_not_depend_on_how_a_photograph_is_stored(tmp_path: pathlib.Path) -> None:
    digests = set()
    for orientation in (1, 6, 8):
        photograph(tmp_path / str(orientation), orientation, "upright", (30, 20))
        exif = Image.Exif()
        exif[EXIF_ORIENTATION] = orientation
        with Image.open(tmp_path / "1" / "images" / "a.png") as upright:
            turn = STORED[orientation]
            stored = upright.copy() if turn is None else upright.transpose(turn)
        stored.save(tmp_path / str(orientation) / "images" / "a.png", exif=exif)
        digests.add(LabeledImageSet.load(tmp_path / str(orientation)).digest)
    assert len(digests) == 1


@pytest.mark.parametrize(
    "content", ['{"masks_drawn_on": "both"}', '{"large_masks": "yes"}', "[]", '{"masks": "stored"}']
)
def test_options_with_other_content_are_refused(tmp_path: pathlib.Path, content: str) -> None:
    photograph(tmp_path, 1, "upright", (30, 20))
    (tmp_path / "dataset.json").write_text(content)
    with pytest.raises(DataError, match=r"dataset\.json: (must hold|is invalid)"):
        LabeledImageSet.load(tmp_path)


def test_options_stand_beside_the_obstacle(tmp_path: pathlib.Path) -> None:
    _, mask = photograph(tmp_path, 3, "stored", (30, 20))
    (tmp_path / "dataset.json").write_text('{"obstacle": "coffee_cup", "masks_drawn_on": "stored"}')
    cups = LabeledImageSet.load(tmp_path)
    assert (cups.info.obstacle, cups.options.masks_drawn_on) == ("coffee_cup", "stored")
    np.testing.assert_array_equal(cups.read(0)[1], mask)


def test_reduced_pair_keeps_image_and_mask_together(tmp_path: pathlib.Path) -> None:
    for kind in ("images", "masks"):
        (tmp_path / kind).mkdir()
    mask = np.zeros((600, 400), np.uint8)
    mask[150:450, 100:300] = 255
    stored = np.ascontiguousarray(np.rot90(np.dstack([mask] * 3)))
    exif = Image.Exif()
    exif[EXIF_ORIENTATION] = 6
    Image.fromarray(stored).save(tmp_path / "images" / "a.jpg", exif=exif, quality=95)
    Image.fromarray(mask).save(tmp_path / "masks" / "a.png")
    rgb, small = LabeledImageSet.load(tmp_path).read(0, 6000)
    assert rgb.shape == (94, 63, 3)
    assert small.shape == (94, 63)
    assert ((rgb[..., 0] > 127) == (small == 1)).mean() > 0.99
