"""Sets of labeled hands in the format of ``datasets/hands``; an interrupted run can be resumed."""

import pathlib

from deltasafe.compute.progress import Progress, silent
from deltasafe.io.storage import atomic_file, sha256_of_file, write_json
from generator.datasheet import write_datasheet
from generator.picture_folder import missing_items, render_image_and_mask
from generator.placement import place_hand
from generator.recipe_sampling import sample_hand_recipe
from generator.render import Renderer
from generator.settings import HandSetSettings
from generator.surroundings import Surroundings


def make_hands(
    folder: str | pathlib.Path,
    count: int,
    settings: HandSetSettings,
    surroundings: Surroundings | None = None,
    progress: Progress = silent,
) -> None:
    """Render pictures 0 to ``count`` - 1 into ``folder``: ``images/``, ``masks/``, ``recipes/``, ``dataset.json``,
    datasheet, registry.

    Picture i is a function of settings, surroundings and i alone. Existing pictures are kept, so an interrupted run
    resumes, and a larger ``count`` extends a complete set.

    Raises:
        SettingsError: ``count`` is not positive, or Mitsuba is not installed.
        DataError: the folder holds pictures made with other settings or surroundings.
    """
    folder, surroundings = pathlib.Path(folder), surroundings or Surroundings()
    renderer = Renderer(settings.variant)
    recipe_files = [folder / "recipes" / f"hand_{index:04d}.json" for index in range(count)]
    for index in missing_items(folder, recipe_files, settings, surroundings, progress):
        recipe = sample_hand_recipe(settings, surroundings, index)
        image, mask = render_image_and_mask(renderer, recipe, place_hand(recipe), surroundings, settings)
        stem = recipe_files[index].stem
        for path, content in ((folder / "masks" / f"{stem}.png", mask), (folder / "images" / f"{stem}.jpg", image)):
            with atomic_file(path) as temporary:
                temporary.write_bytes(content)
        write_json(recipe_files[index], recipe)  # written last, because it marks the picture as complete
    write_datasheet(folder, "recipes/*.json", settings)
    write_json(folder / "dataset.json", {"images": "rendered"})
    files = sorted(path for kind in ("images", "masks", "recipes") for path in (folder / kind).iterdir())
    files = [folder / "dataset.json", *files]
    lines = [f"{sha256_of_file(path)}  {path.relative_to(folder).as_posix()}\n" for path in files]
    with atomic_file(folder / "registry.sha256") as temporary:
        temporary.write_text("".join(lines), encoding="utf-8")
    progress(count, count, f"{count} pictures are in {folder}")
