"""Steps that sets of hands and scenes share: render one picture, resume a folder, reject other settings."""

import dataclasses
import io
import pathlib
from collections.abc import Iterator, Sequence

import numpy as np
from PIL import Image

from deltasafe.compute.progress import Progress
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import digest_of, read_json, sha256_of_file, write_json
from generator.placement import PlacedHand
from generator.recipe import Recipe
from generator.render import Renderer
from generator.settings import PictureSettings
from generator.stage_building import build_stage
from generator.surroundings import Surroundings
from generator.webcam import webcam_jpeg

MASK_COVERAGE = 0.5


def render_image_and_mask(
    renderer: Renderer, recipe: Recipe, hand: PlacedHand, surroundings: Surroundings, settings: PictureSettings
) -> tuple[bytes, bytes]:
    """Render a recipe as a JPEG file, and its mask (255 = hand) as a PNG file.

    Raises:
        DataError: the recipe names surroundings that do not exist.
    """
    stage = build_stage(recipe, surroundings, hand, settings.width, settings.height)
    seed = int(digest_of([recipe.seed, recipe.index])[:7], 16)
    picture = renderer.render(stage, settings.samples_per_pixel, seed)
    mask = io.BytesIO()
    Image.fromarray(np.where(picture.coverage >= MASK_COVERAGE, 255, 0).astype(np.uint8)).save(mask, "PNG")
    return webcam_jpeg(picture.radiance, picture.coverage, recipe.webcam), mask.getvalue()


def missing_items(
    folder: pathlib.Path,
    completion_files: Sequence[pathlib.Path],
    settings: PictureSettings,
    surroundings: Surroundings,
    progress: Progress,
) -> Iterator[int]:
    """Yield the index of each item whose completion file does not exist yet, and report progress.

    Raises:
        SettingsError: there are no items.
        DataError: the folder was started with other settings or surroundings.
    """
    count = len(completion_files)
    if not count:
        raise SettingsError("count must be at least 1")
    _check_or_write_settings(folder, settings, surroundings)
    for index, path in enumerate(completion_files):
        progress(index, count, path.relative_to(folder).as_posix())
        if not path.is_file():
            yield index


def _check_or_write_settings(folder: pathlib.Path, settings: PictureSettings, surroundings: Surroundings) -> None:
    record = {
        "settings": dataclasses.asdict(settings),
        "surroundings": {
            "maps": {name: sha256_of_file(path) for name, path in surroundings.map_files.items()},
            "surfaces": {name: sha256_of_file(path) for name, path in surroundings.surface_files.items()},
        },
    }
    path = folder / "settings.json"
    if not path.exists():
        if folder.is_dir() and any(folder.iterdir()):
            raise DataError(folder, "is not empty and has no settings.json; choose another folder")
        write_json(path, record)
        return
    known = read_json(path)
    if changed := [key for key in record if digest_of(record[key]) != digest_of(known.get(key))]:
        raise DataError(path, f"differs in {', '.join(changed)}; choose another folder, or use the recorded settings")
