"""Copy pictures of a recorded run into the documentation, in small sizes."""

import pathlib
import shutil

from deltasafe.io.storage import atomic_folder, read_json


def record_report(folder: pathlib.Path, destination: pathlib.Path) -> None:
    """Copy `report.md`, its films, and its plots with 128 colors; ``destination`` is replaced."""
    from PIL import Image

    with atomic_folder(destination) as temporary:
        for file in (folder / "report.md", *sorted(folder.glob("*.gif"))):
            shutil.copyfile(file, temporary / file.name)
        for plot in sorted(folder.glob("*.png")):
            with Image.open(plot) as opened:
                reduced = opened.convert("RGB").quantize(128, dither=Image.Dither.NONE)
            reduced.save(temporary / plot.name, optimize=True)


def record_pictures(
    augmented: pathlib.Path, calibration: pathlib.Path, safety: pathlib.Path, destination: pathlib.Path
) -> None:
    """Copy the pictures of the README: contact sheet, reliability diagram, plan and film of the closest execution.

    Args:
        augmented, calibration, safety: folders of the augmented set and of the two reports.
        destination: folder of the pictures, replaced.
    """
    from PIL import Image

    with atomic_folder(destination) as temporary:
        shutil.copyfile(calibration / "reliability.png", temporary / "reliability.png")
        pictures = {"augmentation": augmented.with_name(f"{augmented.name}-sheet.png")}
        filmed = [scene for scene in read_json(safety / "report.json")["scenes"] if scene["film"]]
        if filmed:
            distance_m = [scene["verdict"]["min_tool_to_hand_m"] for scene in filmed]  # None: no true hand
            closest = filmed[min(range(len(filmed)), key=lambda n: (distance_m[n] is None, distance_m[n] or 0.0))]
            shutil.copyfile(safety / closest["film"], temporary / "execution.gif")
            pictures["plan"] = safety / f"{closest['scene_id']}-plan.png"
        for name, path in pictures.items():
            with Image.open(path) as opened:
                picture = opened.convert("RGB")
            picture.thumbnail((1600, 1600))
            picture.save(temporary / f"{name}.jpg", quality=82)
