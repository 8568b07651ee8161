"""Sets of labelled pictures of hands, in the form of ``datasets/hands``; stopped and started again at will."""

import dataclasses
import io
import pathlib
from typing import Any

from PIL import Image

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_file, digest_of, read_json, sha256_of_file, write_json
from generator.datasheet import write_hands_datasheet
from generator.drawing import draw_hand
from generator.mask import mask_of
from generator.recipe import Recipe
from generator.render import Renderer
from generator.settings import HandSetSettings, PictureSettings
from generator.staging import place_hand, set_stage
from generator.surroundings import CollisionArrays
from generator.webcam import develop

__all__ = ["keep_to_settings", "make_hands", "render_hand"]


def make_hands(
    folder: str | pathlib.Path,
    count: int,
    settings: HandSetSettings,
    surroundings: CollisionArrays | None = None,
    progress: Progress = silent,
) -> pathlib.Path:
    """Fill ``folder`` with pictures 0 to ``count`` - 1: ``images/``, ``masks/``, ``recipes/``, datasheet and registry.

    Picture i is a function of settings, surroundings and i alone. Those that are there already are kept, so that a
    stopped run goes on, and a finished set grows by a larger ``count``.

    Raises:
        SettingsError: ``count`` is not positive, or Mitsuba is not installed.
        DataError: the folder holds pictures made with other settings or surroundings.
    """
    if count < 1:
        raise SettingsError(f"count must be at least 1, got {count}")
    folder, surroundings = pathlib.Path(folder), surroundings or CollisionArrays()
    renderer = Renderer(settings.variant)
    keep_to_settings(folder, "hands", settings, surroundings)
    for index in range(count):
        name = f"hand_{index:04d}"
        progress(index, count, name)
        recipe_path = folder / "recipes" / f"{name}.json"
        if recipe_path.is_file():
            continue
        recipe = draw_hand(settings, surroundings, index)
        image, mask = render_hand(renderer, recipe, surroundings, settings)
        for path, content in ((folder / "masks" / f"{name}.png", mask), (folder / "images" / f"{name}.jpg", image)):
            with atomic_file(path) as temporary:
                temporary.write_bytes(content)
        write_json(recipe_path, recipe)  # last: what has a recipe is complete
    write_hands_datasheet(folder, settings)
    _write_registry(folder)
    progress(count, count, f"{count} pictures lie in {folder}")
    return folder


def render_hand(
    renderer: Renderer, recipe: Recipe, surroundings: CollisionArrays, settings: PictureSettings
) -> tuple[bytes, bytes]:
    """JPEG of the picture and PNG of its mask (255 = hand).

    Raises:
        DataError: the recipe names surroundings that are not there.
    """
    hand = place_hand(recipe)
    stage = set_stage(recipe, surroundings, hand, settings.width, settings.height)
    picture = renderer.render(stage, settings.samples_per_pixel, _render_seed(recipe))
    mask = io.BytesIO()
    Image.fromarray(mask_of(picture.coverage)).save(mask, "PNG")
    return develop(picture.radiance, picture.coverage, recipe.webcam), mask.getvalue()


def keep_to_settings(folder: pathlib.Path, kind: str, settings: PictureSettings, surroundings: CollisionArrays) -> None:
    """Write down what a folder's pictures are made from, or compare with what is written there.

    Raises:
        DataError: the folder was begun with something else.
    """
    record: dict[str, Any] = {
        "kind": kind,
        "settings": dataclasses.asdict(settings),
        "surroundings": {
            "maps": {name: sha256_of_file(path) for name, path in surroundings.map_files.items()},
            "surfaces": {name: sha256_of_file(path) for name, path in surroundings.surface_files.items()},
        },
    }
    path = folder / "settings.json"
    if not path.exists():
        if folder.is_dir() and any(folder.iterdir()):
            raise DataError(folder, "is not empty and holds no settings.json; choose another folder")
        write_json(path, record)
        return
    known = read_json(path)
    changed = [key for key in record if digest_of(record[key]) != digest_of(known.get(key))]
    if changed:
        raise DataError(path, f"differs in {', '.join(changed)}; choose another folder, or the settings of this one")


def _render_seed(recipe: Recipe) -> int:
    return int(digest_of([recipe.seed, recipe.index])[:7], 16)


def _write_registry(folder: pathlib.Path) -> None:
    files = sorted(path for kind in ("images", "masks", "recipes") for path in (folder / kind).iterdir())
    lines = [f"{sha256_of_file(path)}  {path.relative_to(folder).as_posix()}\n" for path in files]
    with atomic_file(folder / "registry.sha256") as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")
