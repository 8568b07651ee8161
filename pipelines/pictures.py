"""Pictures for the README: what a recorded run made, in sizes that a page can show."""

import pathlib
import shutil

__all__ = ["record_pictures"]


def record_pictures(
    augmented: pathlib.Path, calibration: pathlib.Path, safety: pathlib.Path, destination: pathlib.Path
) -> None:
    """Copy the contact sheet, the reliability diagram, and plan and film of the closest execution.

    Args:
        augmented, calibration, safety: folders of the run's augmented set and of its two reports.
        destination: folder of the pictures, replaced.
    """
    from PIL import Image

    from deltasafe.storage import atomic_folder, read_json

    with atomic_folder(destination) as temporary:
        shutil.copyfile(calibration / "reliability.png", temporary / "reliability.png")
        pictures = {"augmentation": augmented.with_name(f"{augmented.name}-sheet.png")}
        filmed = [scene for scene in read_json(safety / "report.json")["scenes"] if scene["film"]]
        if filmed:
            closest = min(filmed, key=lambda scene: scene["verdict"]["min_tool_to_hand_m"] or 0.0)
            shutil.copyfile(safety / closest["film"], temporary / "execution.gif")
            pictures["plan"] = safety / f"{closest['scene_id']}-plan.png"
        for name, path in pictures.items():
            with Image.open(path) as opened:
                picture = opened.convert("RGB")
            picture.thumbnail((1600, 1600))
            picture.save(temporary / f"{name}.jpg", quality=82)
