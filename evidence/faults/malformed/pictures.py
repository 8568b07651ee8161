"""Images and masks, in hand sets and alone: cut short, bombs, turned, in other forms, of other values."""

import io
import pathlib
import shutil
import struct
import zlib
from collections.abc import Callable, Iterator
from random import Random

import numpy as np
from PIL import Image

from deltasafe.perception.hands import HandSet, read_rgb
from evidence.faults.judging import Case, Door, Spoil, rewrite
from evidence.faults.malformed.files import at, file_spoils, filled

__all__ = ["hand_cases", "picture_cases"]

EXIF_ORIENTATION = 0x0112
NAMES = ("hand_a", "hand_b", "hand_c")
Change = Callable[[pathlib.Path, Random], None]


def picture_cases(home: pathlib.Path, datasets: pathlib.Path, ensemble: pathlib.Path) -> list[Case]:
    """A picture for ``deltasafe predict``."""
    sound = home / "picture.jpg"
    shutil.copyfile(_first(datasets / "hands" / "train" / "images"), sound)

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        read_rgb(given)

    def command(given: pathlib.Path, out: pathlib.Path) -> list[str]:
        return ["predict", str(ensemble), str(given), "-o", str(out / "answer.png")]

    door = Door("picture", sound, read, command)
    return [Case(name, door, at("", change)) for name, change in {**file_spoils(), **_images(sound)}.items()]


def hand_cases(home: pathlib.Path, datasets: pathlib.Path) -> list[Case]:
    """A set of three hands and their masks."""
    train, sound = datasets / "hands" / "train", home / "hands"
    stems = sorted(path.stem for path in (train / "images").iterdir())[: len(NAMES)]
    for kind in ("images", "masks"):
        (sound / kind).mkdir(parents=True)
        for stem, name in zip(stems, NAMES, strict=True):
            source = next((train / kind).glob(f"{stem}.*"))
            shutil.copyfile(source, sound / kind / f"{name}{source.suffix}")

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        HandSet.load(given)

    door = Door("hands", sound, read)
    image = _first(sound / "images")
    mask = _first(sound / "masks")
    spoils: dict[str, Spoil] = {}
    for name, change in {**file_spoils(), **_images(image)}.items():
        spoils[f"image: {name}"] = at(f"images/{image.name}", change)
    for name, change in {**file_spoils(), **dict(_masks(mask))}.items():
        spoils[f"mask: {name}"] = at(f"masks/{mask.name}", change)
    for kind, name in (("image", f"images/{image.name}"), ("mask", f"masks/{mask.name}")):
        spoils[f"{kind}: missing"] = _without(name)
    return [Case(name, door, spoil) for name, spoil in {**spoils, **_sets(image.name, mask.name)}.items()]


def _without(name: str) -> Spoil:
    """The message is about the file that is left."""

    def spoil(given: pathlib.Path, random: Random) -> str:
        (given / name).unlink()
        return pathlib.PurePath(name).stem

    return spoil


def _images(sound: pathlib.Path) -> dict[str, Change]:
    data = sound.read_bytes()
    with Image.open(io.BytesIO(data)) as opened:
        picture = opened.convert("RGB")
    png, jpeg = _stored(picture, "PNG"), _stored(picture, "JPEG")
    spoils = {
        f"{form} cut at {share:g}": _cut(whole, share)
        for form, whole in (("png", png), ("jpeg", jpeg))
        for share in (0.01, 0.1, 0.3, 0.6, 0.9, 0.99)
    }
    for width, height in ((2**31 - 1, 2**31 - 1), (100_000, 100_000), (0, 100), (30_000, 30_000)):
        spoils[f"png claims {width} x {height}"] = filled(_png_of_size(png, width, height))
    for width, height in ((65_535, 65_535), (65_500, 20_000), (0, 100), (30_000, 30_000)):
        spoils[f"jpeg claims {width} x {height}"] = filled(_jpeg_of_size(jpeg, width, height))
    spoils["png that unpacks to 400 million pixels"] = filled(_stored(Image.new("1", (20_000, 20_000)), "PNG"))
    for orientation in range(2, 9):
        spoils[f"exif orientation {orientation}"] = filled(_turned(picture, "JPEG", orientation))
    spoils["exif orientation in a png"] = filled(_turned(picture, "PNG", 6))
    deep = np.asarray(picture.convert("L"), np.uint16) * 257
    spoils["png of 16 bits"] = filled(_stored(Image.fromarray(deep), "PNG"))
    for mode in ("L", "RGBA", "LA"):
        spoils[f"png of mode {mode}"] = filled(_stored(picture.convert(mode), "PNG"))
    for mode in ("L", "CMYK"):
        spoils[f"jpeg of mode {mode}"] = filled(_stored(picture.convert(mode), "JPEG"))
    spoils["tiff of floats"] = filled(_stored(picture.convert("F"), "TIFF"))
    spoils["palette with a transparent colour"] = filled(_stored(picture.quantize(16), "PNG", transparency=0))
    for n in range(5):
        spoils[f"png with damaged data, {n}"] = _damaged(png)
    spoils["jpeg without its tables"] = filled(jpeg[:2] + jpeg[jpeg.index(b"\xff\xda") :])
    return spoils


def _masks(sound: pathlib.Path) -> Iterator[tuple[str, Change]]:
    with Image.open(sound) as opened:
        mask = np.array(opened.convert("L"))
    height, width = mask.shape
    png = _stored(Image.fromarray(mask), "PNG")
    for share in (0.1, 0.5, 0.9):
        yield f"cut at {share:g}", _cut(png, share)
    for size in ((width + 1, height), (width, height - 1), (height, width), (1, 1), (2 * width, 2 * height)):
        yield f"of size {size}", filled(_stored(Image.fromarray(mask).resize(size, 0), "PNG"))
    for value in (1, 2, 100, 127, 128, 200, 254):
        yield f"one pixel of value {value}", filled(_stored(Image.fromarray(_with(mask, value)), "PNG"))
    yield "of 0 and 1", filled(_stored(Image.fromarray(mask // 255), "PNG"))
    yield "without a hand", filled(_stored(Image.fromarray(np.zeros_like(mask)), "PNG"))
    yield "of 16 bits", filled(_stored(Image.fromarray(mask.astype(np.uint16) * 257), "PNG"))
    yield "of floats", filled(_stored(Image.fromarray(mask).convert("F"), "TIFF"))
    for mode in ("RGB", "RGBA", "LA"):
        yield f"of mode {mode}", filled(_stored(Image.fromarray(mask).convert(mode), "PNG"))
    coloured = Image.fromarray(mask).convert("RGB").quantize(4)
    yield "with a palette", filled(_stored(coloured, "PNG"))
    noisy = np.clip(mask.astype(int) + np.random.default_rng(0).integers(-9, 9, mask.shape), 0, 255)
    yield "with noise", filled(_stored(Image.fromarray(noisy.astype(np.uint8)), "PNG"))
    yield "turned by exif", filled(_turned(Image.fromarray(mask), "PNG", 3))
    for n in range(3):
        yield f"with damaged data, {n}", _damaged(png)


def _sets(image: str, mask: str) -> dict[str, Spoil]:
    def renamed(kind: str, name: str) -> Spoil:
        def spoil(given: pathlib.Path, random: Random) -> str:
            path = given / kind / name
            path.rename(path.with_name(f"other{path.suffix}"))
            return path.stem

        return spoil

    def without(kind: str) -> Spoil:
        def spoil(given: pathlib.Path, random: Random) -> str:
            shutil.rmtree(given / kind)
            return kind

        return spoil

    def emptied(given: pathlib.Path, random: Random) -> str:
        for path in [*given.glob("*/*")]:
            path.unlink()
        return given.name

    def with_stray(kind: str, name: str) -> Spoil:
        def spoil(given: pathlib.Path, random: Random) -> str:
            (given / kind / name).write_text("x")
            return name

        return spoil

    def with_folder(given: pathlib.Path, random: Random) -> str:
        (given / "images" / "more.png").mkdir()
        (given / "masks" / "more.png").mkdir()
        return "more.png"

    def same_stem(given: pathlib.Path, random: Random) -> str:
        shutil.copyfile(given / "images" / image, given / "images" / f"{pathlib.PurePath(image).stem}.JPEG")
        return pathlib.PurePath(image).stem

    def a_file(given: pathlib.Path, random: Random) -> str:
        shutil.rmtree(given)
        given.write_text("hands")
        return given.name

    return {
        "image of another stem": renamed("images", image),
        "mask of another stem": renamed("masks", mask),
        "no masks": without("masks"),
        "no images": without("images"),
        "nothing in it": emptied,
        "a text among the images": with_stray("images", "notes.txt"),
        "a text among the masks": with_stray("masks", "notes.md"),
        "a program among the images": with_stray("images", "image.py"),
        "folders among the images": with_folder,
        "two images of one stem": same_stem,
        "no folder at all": a_file,
    }


def _first(folder: pathlib.Path) -> pathlib.Path:
    return min(folder.iterdir())


def _stored(picture: Image.Image, form: str, **options: object) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, form, **options)
    return stream.getvalue()


def _turned(picture: Image.Image, form: str, orientation: int) -> bytes:
    exif = Image.Exif()
    exif[EXIF_ORIENTATION] = orientation
    return _stored(picture, form, exif=exif)


def _cut(data: bytes, share: float) -> Change:
    return filled(data[: int(share * len(data))])


def _with(mask: np.ndarray, value: int) -> np.ndarray:
    changed = mask.copy()
    changed[3, 3] = value
    return changed


def _png_of_size(data: bytes, width: int, height: int) -> bytes:
    header = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


def _jpeg_of_size(data: bytes, width: int, height: int) -> bytes:
    frame = data.index(b"\xff\xc0")
    return data[: frame + 5] + struct.pack(">HH", height, width) + data[frame + 9 :]


def _damaged(png: bytes) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        first = png.index(b"IDAT") + 4
        place = random.randrange(first, len(png) - 16)
        rewrite(path, png[:place] + bytes([png[place] ^ (1 << random.randrange(8))]) + png[place + 1 :])

    return change
