"""Convert label files that the tools themselves wrote, and count the pixels that differ from what the tools read back.

The files are in ``tests/golden/labels``, with the program that wrote them. Plain folders have a mask of each kind.
"""

import pathlib
import shutil
import sys
import tempfile

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deltasafe.perception.data.importing.import_hands import import_hands
from deltasafe.perception.data.importing.settings import ImportSettings
from evidence.faults.welcome import mask_kinds
from evidence.reporting import command_parser, finish

GOLDEN = pathlib.Path(__file__).parents[1] / "tests" / "golden" / "labels"
# by source: its format, and where the format has its images
SOURCES = {
    "coco": ("coco", "images/train"),
    "coco-runs": ("coco", "train"),
    "coco-compressed": ("coco", "."),
    "cvat": ("cvat", "images"),
    "cvat-masks": ("cvat-masks", "JPEGImages"),
    "labelme": ("labelme", "../images"),
    "label-studio": ("label-studio", "deeper/images"),
    "voc": ("voc", "JPEGImages"),
    "roboflow": ("roboflow", "train"),
}


def lay_out(name: str, parent: pathlib.Path) -> pathlib.Path:
    """Copy labels and images of a source to where its format has them."""
    folder = parent / name
    shutil.copytree(GOLDEN / name, folder)
    shutil.copytree(GOLDEN / "images", folder / SOURCES[name][1], dirs_exist_ok=True)
    return folder


def read_masks(folder: pathlib.Path) -> dict[str, NDArray[np.bool_]]:
    """Return the masks of a folder by stem."""
    return {path.stem: np.asarray(Image.open(path)) != 0 for path in folder.iterdir()}


def differing_pixels(name: str, work: pathlib.Path) -> int:
    """Convert a source, and count the pixels that differ from the tool's own."""
    settings = ImportSettings(SOURCES[name][0], ("person",) if name == "voc" else ("hand",))
    import_hands(lay_out(name, work), work / "converted" / name, settings)
    found = read_masks(work / "converted" / name / "masks")
    return sum(int((found[stem] != mask).sum()) for stem, mask in read_masks(GOLDEN / "expected" / name).items())


def differing_pixels_of_kinds(work: pathlib.Path) -> int:
    """Convert plain folders with a mask of each kind, and count the pixels that differ."""
    mask = read_masks(GOLDEN / "expected" / "labelme")["one hand"]
    differing = 0
    for name, data in mask_kinds(mask.astype(np.uint8) * 255).items():
        folder = work / f"plain {name}"
        for part in ("images", "masks"):
            (folder / part).mkdir(parents=True)
        shutil.copyfile(GOLDEN / "images" / "one hand.jpg", folder / "images" / "a.jpg")
        (folder / "masks" / "a.png").write_bytes(data)
        import_hands(folder, work / "converted" / folder.name)
        differing += int((read_masks(work / "converted" / folder.name / "masks")["a"] != mask).sum())
    return differing


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.labels``."""
    options = command_parser("labels", __doc__).parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        work = pathlib.Path(temporary)
        differing = {name: differing_pixels(name, work) for name in SOURCES}
        differing["folder"] = differing_pixels_of_kinds(work)
    formats = {name: SOURCES[name][0] if name in SOURCES else name for name in differing}
    exact = set(formats.values()) - {formats[name] for name, n in differing.items() if n}
    failures = [f"{name}: {n} pixels differ" for name, n in differing.items() if n]
    return finish(
        options, {"label_formats": len(exact), "label_sources": len(differing)}, failures, differing=differing
    )


if __name__ == "__main__":
    sys.exit(main())
