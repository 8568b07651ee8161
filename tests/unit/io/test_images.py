"""Every kind of image that people have is read right, or refused with a remedy that works when it is followed."""

import base64
import io
import pathlib
import sys
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io import images
from deltasafe.io.images import decode_image, fitting_size, read_image, read_rgb

ORIENTATION = 0x0112
# Exif 2.3, table 6: visual side of the 0th row and of the 0th column of the stored pixels
SIDES = {
    1: ("top", "left"),
    2: ("top", "right"),
    3: ("bottom", "right"),
    4: ("bottom", "left"),
    5: ("left", "top"),
    6: ("right", "top"),
    7: ("right", "bottom"),
    8: ("left", "bottom"),
}
PHOTO = np.random.default_rng(0).integers(0, 256, (12, 20, 3), dtype=np.uint8)


def stored_pixels(upright: np.ndarray, orientation: int) -> np.ndarray:
    """What a camera stores so that viewers show ``upright``: entry (r, c) lies r from one side and c from the other."""
    height, width = upright.shape[:2]
    row_side, column_side = SIDES[orientation]
    shape = (height, width) if row_side in ("top", "bottom") else (width, height)
    stored = np.empty((*shape, *upright.shape[2:]), upright.dtype)
    for r in range(shape[0]):
        for c in range(shape[1]):
            place = {row_side: r, column_side: c}
            y = place["top"] if "top" in place else height - 1 - place["bottom"]
            x = place["left"] if "left" in place else width - 1 - place["right"]
            stored[r, c] = upright[y, x]
    return stored


def saved(
    path: pathlib.Path, pixels: np.ndarray | Image.Image, form: str, orientation: int = 1, **options
) -> pathlib.Path:
    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(pixels)
    exif = Image.Exif()
    if orientation != 1:
        exif[ORIENTATION] = orientation
    image.save(path, form, exif=exif, **options)
    return path


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
@given(
    orientation=st.sampled_from(range(1, 9)),
    form=st.sampled_from([("PNG", {}), ("TIFF", {}), ("WEBP", {"lossless": True})]),
    size=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    seed=st.integers(0, 99),
)
def test_pixels_are_upright_in_every_orientation_and_lossless_format(tmp_path, orientation, form, size, seed) -> None:
    upright = np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)
    path = saved(tmp_path / "image", stored_pixels(upright, orientation), form[0], orientation, **form[1])
    image = read_image(path)
    np.testing.assert_array_equal(image.rgb, upright)
    assert (image.size, image.orientation) == ((size[1], size[0]), orientation)


@pytest.mark.parametrize("form", ["JPEG", "AVIF"])
def test_lossy_photographs_are_upright(tmp_path: pathlib.Path, form: str) -> None:
    if form not in Image.SAVE:
        pytest.skip("this Pillow has no AVIF")
    upright = np.zeros((40, 24, 3), np.uint8)
    upright[:10] = (250, 0, 0)
    rgb = read_rgb(saved(tmp_path / "image", stored_pixels(upright, 6), form, 6, quality=95))
    assert np.abs(rgb.astype(int) - upright).mean() < 8


@pytest.mark.parametrize("orientation", [0, 9, 77])
def test_undefined_orientations_are_upright(tmp_path: pathlib.Path, orientation: int) -> None:
    image = read_image(saved(tmp_path / "image.png", PHOTO, "PNG", orientation))
    np.testing.assert_array_equal(image.rgb, PHOTO)
    assert image.orientation == 1


def test_damaged_exif_data_are_ignored(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "image.jpg"
    Image.fromarray(PHOTO).save(path, exif=b"Exif\x00\x00II*\x00\xff\xff\xff\x7f broken")
    assert read_image(path).orientation == 1


GRAY = np.asarray(Image.fromarray(PHOTO).convert("L"))
KINDS = {
    "gray": (Image.fromarray(GRAY), np.dstack([GRAY] * 3)),
    "one bit": (Image.fromarray(GRAY > 127), np.dstack([(GRAY > 127).astype(np.uint8) * 255] * 3)),
    "palette": (Image.fromarray(PHOTO).quantize(16), np.asarray(Image.fromarray(PHOTO).quantize(16).convert("RGB"))),
    "opaque alpha": (Image.fromarray(np.dstack([PHOTO, np.full((12, 20), 255, np.uint8)])), PHOTO),
    "gray with opaque alpha": (Image.fromarray(GRAY).convert("LA"), np.dstack([GRAY] * 3)),
    "gray with 16 bits": (Image.fromarray(GRAY.astype(np.uint16) * 257), np.dstack([GRAY] * 3)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("orientation", [1, 6])
def test_modes_are_read_as_rgb(tmp_path: pathlib.Path, kind: str, orientation: int) -> None:
    image, expected = KINDS[kind]
    turned = image if orientation == 1 else image.transpose(Image.Transpose.ROTATE_90)
    np.testing.assert_array_equal(read_rgb(saved(tmp_path / "i.png", turned, "PNG", orientation)), expected)


def test_color_with_16_bits_keeps_its_high_bytes(tmp_path: pathlib.Path) -> None:
    cv2 = pytest.importorskip("cv2")
    assert cv2.imwrite(str(tmp_path / "deep.png"), PHOTO[..., ::-1].astype(np.uint16) * 257)
    np.testing.assert_array_equal(read_rgb(tmp_path / "deep.png"), PHOTO)


def test_cmyk_photograph_has_its_colors(tmp_path: pathlib.Path) -> None:
    flat = np.zeros((16, 16, 3), np.uint8)
    flat[:, :8], flat[:, 8:] = (200, 40, 40), (20, 90, 160)
    path = saved(tmp_path / "print.jpg", Image.fromarray(flat).convert("CMYK"), "JPEG", quality=98)
    assert np.abs(read_rgb(path).astype(int) - flat).mean() < 4


# 24 x 16 pixels: the upper half is red, below it are green and blue; written by pillow-heif 1.8, then compressed
HEIC = (
    "c-muNV30{GsVvAy&8%Pmg51nBLl8SRGck>Ufw3+(wIq=N0u(b+a*CjAhJwuG5(YG&l$n#C3}U!AFfalk5HK!+&_ECZ#LAhOd1+uCNK_QaNo9iaGRl$-"
    "K}^1a%#vKVl7E>6MFl|mUS>gZK9DX4DsyIJ;Q%t{S%4JDePH<W|Hlso27cxQpbl{dMjpoh|3M0v!77-6N_H_hBm(8MoERBVB_^;4C~UeLdO79}i;08)"
    "P>gW`NJ5|?38<XIh4Emqgn<N5h(S0xKc^@!Ii~_B&db2o02C6*EG|fedd&ffHIj1@L9Ug6x?TW8|NsC029Ra~(icE9NW37kA`_&MnS%r56^YD(Tv#Xr1"
    "CF(kiJ7$p$d1WPNd$#*fCl4w&J$UEa>_G<_n-Lx`{N1k$9E@wb^iS=am|;HyU)J~kqap+wAm05V`*B?sC?T&%`ar}C9$Z}Y1`+kMt0?GjWYRGZ+AxY7<"
    "0qZlQM<7ZU6w;mUR3"
)


@pytest.mark.parametrize("name", ["IMG_0001.HEIC", "IMG_0001.jpg"])  # some phones rename it on transfer
def test_heic_photograph_is_read(tmp_path: pathlib.Path, name: str) -> None:
    pytest.importorskip("pi_heif")
    (tmp_path / name).write_bytes(zlib.decompress(base64.b85decode(HEIC)))
    expected = np.full((16, 24, 3), (220, 40, 40))
    expected[8:, :12], expected[8:, 12:] = (40, 160, 60), (40, 60, 200)
    assert np.abs(read_rgb(tmp_path / name).astype(int) - expected).mean() < 3


def test_heic_photograph_without_its_package_names_the_extra(tmp_path: pathlib.Path, monkeypatch) -> None:
    (tmp_path / "a.jpg").write_bytes(zlib.decompress(base64.b85decode(HEIC)))
    monkeypatch.setitem(sys.modules, "pi_heif", None)
    monkeypatch.setattr(Image, "OPEN", {name: entry for name, entry in Image.OPEN.items() if name != "HEIF"})
    with pytest.raises(DataError, match=r"a\.jpg: is a HEIC image; install the extra heic \(pip install pi-heif\)"):
        read_rgb(tmp_path / "a.jpg")


def with_alpha() -> Image.Image:
    alpha = np.full((12, 20), 255, np.uint8)
    alpha[:3] = 0
    return Image.fromarray(np.dstack([PHOTO, alpha]))


REFUSED = {
    "transparent": (with_alpha(), "PNG", r"transparent in 25\.0% of its pixels; save it without transparency"),
    "12 bits of 16": (
        Image.fromarray(GRAY.astype(np.uint16) * 16),
        "PNG",
        r"values from \d+ to \d+; convert it to RGB",
    ),
    "floats": (Image.fromarray(GRAY.astype(np.float32) / 255), "TIFF", "floating-point values; convert it to RGB"),
    "32 bits": (Image.fromarray(GRAY.astype(np.int32) * 9000), "TIFF", "more than 8 bits per pixel"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_ambiguous_kinds_are_refused_and_the_remedy_works(tmp_path: pathlib.Path, kind: str) -> None:
    image, form, message = REFUSED[kind]
    path = saved(tmp_path / "image", image, form)
    with pytest.raises(DataError, match=message):
        read_rgb(path)
    values = np.asarray(image, np.float64)
    as_told = values[..., :3] if kind == "transparent" else np.rint(255 * values / values.max())
    saved(path, as_told.astype(np.uint8), "PNG")
    assert read_rgb(path).shape == (12, 20, 3)


def test_several_pictures_in_a_file_are_refused(tmp_path: pathlib.Path) -> None:
    pages = [Image.fromarray(PHOTO), Image.fromarray(PHOTO[::-1].copy())]
    for form in ("TIFF", "WEBP"):
        saved(tmp_path / "many", pages[0], form, save_all=True, append_images=pages[1:])
        with pytest.raises(DataError, match="holds 2 pictures; save the one"):
            read_rgb(tmp_path / "many")


def test_preview_of_a_raw_file_is_not_taken_for_the_photograph(tmp_path: pathlib.Path) -> None:
    Image.fromarray(PHOTO).save(tmp_path / "x.dng", "TIFF", tiffinfo={254: 1})
    with pytest.raises(DataError, match="raw file of a camera"):
        read_rgb(tmp_path / "x.dng")


def test_messages_name_the_cause_of_unreadable_files(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = {
        b"": r"is not a readable image \(0 bytes; unknown format\)",
        b"version https://git-lfs.github.com/spec/v1\n": "git lfs pull",
        b"<html>": r"\(6 bytes; unknown format\)",
    }
    for content, message in cases.items():
        (tmp_path / "x.jpg").write_bytes(content)
        with pytest.raises(DataError, match=message) as caught:
            read_rgb(tmp_path / "x.jpg")
        assert "BytesIO" not in str(caught.value)
    path = saved(tmp_path / "big.png", PHOTO, "PNG")
    monkeypatch.setattr(images, "MAX_PIXELS", 200)
    with pytest.raises(DataError, match=r"has 20 x 12 pixels, .* scale it down"):
        read_rgb(path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    with pytest.raises(DataError, match=r"million pixels, .* scale it down"):
        read_rgb(path)


def test_name_that_is_not_utf8_is_refused_and_printable(tmp_path: pathlib.Path) -> None:
    if sys.platform == "darwin":
        pytest.skip("the file system allows UTF-8 only")
    path = saved(tmp_path / "h\udce4nd.png", PHOTO, "PNG")
    with pytest.raises(DataError, match="not UTF-8; rename it") as caught:
        read_rgb(path)
    assert r"h\xe4nd.png" in str(caught.value).encode("utf-8").decode()
    assert read_rgb(path.rename(tmp_path / "händ.png")).shape == (12, 20, 3)


@settings(max_examples=100)
@given(width=st.integers(1, 9000), height=st.integers(1, 9000), limit=st.integers(1, 10**6))
def test_fitting_size_respects_the_limit_and_the_aspect_ratio(width: int, height: int, limit: int) -> None:
    w, h = fitting_size((width, height), limit)
    if width * height <= limit:
        assert (w, h) == (width, height)
    else:
        assert w * h <= limit or 1 in (w, h)
        assert (w + 1) * (h + 1) * max(width * height / limit, 1) >= 0.99 * width * height
    assert fitting_size((width, height), None) == (width, height)


@pytest.mark.parametrize("form", ["JPEG", "PNG"])
def test_reduced_image_is_the_area_mean_of_the_whole(tmp_path: pathlib.Path, form: str) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 640), np.linspace(0, 1, 480))
    smooth = np.stack([255 * x, 255 * y, 120 + 100 * np.sin(6 * x)], axis=-1).astype(np.uint8)
    path = saved(tmp_path / "image", smooth, form, 6)
    reduced = read_image(path, 640 * 480 // 16)
    assert reduced.rgb.shape == (160, 120, 3)
    assert reduced.size == (480, 640)
    mean = np.rot90(smooth, -1).reshape(160, 4, 120, 4, 3).mean(axis=(1, 3))
    assert np.abs(reduced.rgb - mean).mean() < 1.5


def test_reduced_jpeg_is_decoded_small(tmp_path: pathlib.Path) -> None:
    """The decoder itself scales a JPEG, so the whole image is never in memory."""
    path = saved(tmp_path / "large.jpg", Image.new("RGB", (3200, 2400), (90, 120, 60)), "JPEG")
    decoded = decode_image(path, 200_000)
    assert decoded.image.size == (800, 600)
    assert decoded.size == (3200, 2400)
    assert read_rgb(path, 200_000).size <= 3 * 200_000


def test_formats_that_run_other_programs_are_not_opened(tmp_path: pathlib.Path) -> None:
    stream = io.BytesIO()
    Image.fromarray(PHOTO).save(stream, "EPS")
    (tmp_path / "x.png").write_bytes(stream.getvalue())
    with pytest.raises(DataError, match="unknown format"):
        read_rgb(tmp_path / "x.png")
