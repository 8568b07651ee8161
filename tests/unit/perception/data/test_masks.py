"""Masks of every kind are read to the same pixels; what is ambiguous is refused with the option that decides."""

import io
import pathlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.perception.data.masks import dither_defect, polarity_defect, read_marked, read_mask, read_mask_plane

BINARY = arrays.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))).filter(lambda mask: mask.any())


def gray(mask, value, dtype=np.uint8):
    return Image.fromarray(mask.astype(dtype) * dtype(value))


def palette(mask, colors, indices=(0, 1)):
    image = Image.fromarray(np.where(mask, np.uint8(indices[1]), np.uint8(indices[0])))
    image.putpalette([channel for color in colors for channel in color])
    return image


def colored(mask, color, background=(0, 0, 0)):
    return Image.fromarray(np.where(mask[..., None], np.uint8(color), np.uint8(background)))


def floats(mask):
    return Image.fromarray(mask.astype(np.float32))


KINDS = {
    "one bit": (Image.fromarray, "PNG"),
    "0 and 1": (lambda mask: gray(mask, 1), "PNG"),
    "0 and 255": (lambda mask: gray(mask, 255), "PNG"),
    "0 and 255, BMP": (lambda mask: gray(mask, 255), "BMP"),
    "0 and 7": (lambda mask: gray(mask, 7), "PNG"),
    "16 bits, 0 and 65535": (lambda mask: gray(mask, 65535, np.uint16), "PNG"),
    "16 bits, 0 and 1": (lambda mask: gray(mask, 1, np.uint16), "PNG"),
    "floats": (floats, "TIFF"),
    "palette of black and red": (lambda mask: palette(mask, [(0, 0, 0), (128, 0, 0)]), "PNG"),
    "palette, white first": (lambda mask: palette(mask, [(255, 255, 255), (0, 0, 0)], (1, 0)), "PNG"),
    "palette of one color": (lambda mask: palette(mask, [(9, 9, 9), (9, 9, 9)]), "PNG"),
    "equal channels": (lambda mask: colored(mask, (255, 255, 255)), "PNG"),
    "one color": (lambda mask: colored(mask, (250, 50, 83)), "PNG"),
    "equal channels, opaque": (lambda mask: colored(mask, (255, 255, 255)).convert("RGBA"), "PNG"),
    "one color, opaque": (lambda mask: colored(mask, (0, 0, 255)).convert("RGBA"), "PNG"),
    "gray with alpha": (lambda mask: gray(mask, 255).convert("LA"), "PNG"),
    "black on transparent": (lambda mask: colored(mask, (0, 0, 0, 255), (0, 0, 0, 0)), "PNG"),
    "red on transparent white": (lambda mask: colored(mask, (255, 0, 0, 255), (255, 255, 255, 0)), "PNG"),
    "red on transparent, both marked": (lambda mask: colored(mask, (255, 0, 0, 255), (255, 0, 0, 0)), "PNG"),
}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=25, deadline=None)
@given(mask=BINARY)
def test_masks_of_all_kinds_give_the_same_pixels(tmp_path_factory, kind, mask):
    if "alpha" not in kind and "transparent" in kind and mask.all():
        return  # nothing is transparent, so that nothing tells black from black
    make, form = KINDS[kind]
    path = tmp_path_factory.getbasetemp() / "mask"
    make(mask).save(path, form)
    np.testing.assert_array_equal(read_mask(path) == 255, mask)


@pytest.fixture
def square():
    mask = np.zeros((20, 30), bool)
    mask[5:12, 6:20] = True
    return mask


def saved(path: pathlib.Path, image: Image.Image, **options) -> pathlib.Path:
    image.save(path, **options)
    return path


def test_empty_mask_has_no_mark(tmp_path):
    path = saved(tmp_path / "a.png", gray(np.zeros((4, 4), bool), 1))
    assert read_marked(path)[1] == ""
    with pytest.raises(DataError, match="marks no hand"):
        read_mask(path)


def test_several_colors_are_refused_by_name(tmp_path, square):
    pixels = np.asarray(colored(square, (255, 0, 0))).copy()
    pixels[15:18, 2:6] = (0, 255, 0)
    with pytest.raises(DataError, match=r"2 colors besides black \(#ff0000, #00ff00\).* --class '#"):
        read_mask(saved(tmp_path / "a.png", Image.fromarray(pixels)))


def test_soft_masks_need_a_threshold(tmp_path, square):
    ramp = np.linspace(0, 255, 256, dtype=np.uint8)[None].repeat(3, axis=0)
    path = saved(tmp_path / "ramp.png", Image.fromarray(ramp))
    with pytest.raises(DataError, match=r"255 gray values .* --threshold 0\.5"):
        read_mask(path)
    np.testing.assert_array_equal(read_mask_plane(path).above(0.5), ramp >= 128)
    blurred = np.asarray(gray(square, 65535, np.uint16)).copy()
    blurred[:, 10] //= 3
    plane = read_mask_plane(saved(tmp_path / "deep.png", Image.fromarray(blurred)))
    np.testing.assert_array_equal(plane.above(0.3), square)
    assert not plane.above(0.5)[:, 10].any()


@pytest.mark.parametrize("color", [(255, 255, 255), (255, 0, 0), (255, 200, 90)])
def test_jpeg_masks_are_read_with_a_threshold(tmp_path, square, color):
    large = np.kron(square, np.ones((9, 9), bool))  # edges inside the blocks of JPEG
    path = saved(tmp_path / "a.jpg", colored(large, color), quality=90, subsampling=0)
    with pytest.raises(DataError, match="--threshold"):
        read_mask(path)
    np.testing.assert_array_equal(read_mask_plane(path).above(0.5), large)


def test_threshold_refuses_several_colors(tmp_path, square):
    pixels = np.asarray(colored(square, (255, 0, 0))).copy()
    pixels[:10][square[:10]] = (0, 255, 0)
    plane = read_mask_plane(saved(tmp_path / "a.png", Image.fromarray(pixels)))
    with pytest.raises(DataError, match="several colors"):
        plane.above(0.5)


def test_alpha_channel_on_request(tmp_path, square):
    rng = np.random.default_rng(0)
    photograph = np.dstack([rng.integers(0, 256, (20, 30, 3), dtype=np.uint8), square.astype(np.uint8) * 255])
    path = saved(tmp_path / "cutout.png", Image.fromarray(photograph))
    with pytest.raises(DataError, match="colors"):
        read_mask(path)
    np.testing.assert_array_equal(read_mask_plane(path, alpha=True).select("*"), square)
    with pytest.raises(DataError, match="no alpha channel"):
        read_mask_plane(saved(tmp_path / "a.png", gray(square, 255)), alpha=True)


def test_transparent_palette_color_is_background(tmp_path, square):
    image = palette(square, [(255, 0, 255), (0, 255, 0)])
    stream = io.BytesIO()
    image.save(stream, "PNG", transparency=0)
    (tmp_path / "a.png").write_bytes(stream.getvalue())
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png") == 255, square)


@settings(deadline=None)
@given(mask=arrays.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_of_a_mask_and_its_inverse_one_is_suspected(mask):
    suspected = [polarity_defect(one) is not None for one in (mask, ~mask)]
    border = np.concatenate([mask[0], mask[-1], mask[1:-1, 0], mask[1:-1, -1]])
    if mask.mean() + border.mean() == pytest.approx(1):
        return
    assert sorted(suspected) == [False, True]


def test_a_hand_from_the_border_is_not_suspect(square):
    hand = np.zeros((60, 80), bool)
    hand[20:50, :35] = True
    assert polarity_defect(hand) is None
    assert "marks 78% of the image and 89% of its border" in polarity_defect(~hand)


def test_dithered_masks_are_noticed_and_thin_ones_are_not(square):
    gray_hand = Image.fromarray(np.kron(square, np.full((8, 8), 90, np.uint8)))
    assert "dithering" in dither_defect(np.asarray(gray_hand.convert("1")))
    assert dither_defect(np.kron(square, np.ones((8, 8), bool))) is None
    assert dither_defect(np.eye(300, dtype=bool)[:, ::-1] | np.eye(300, k=1, dtype=bool)[:, ::-1]) is None
