"""The datasheet (README.md) of a generated set: commands, settings, contents, sources, licenses and limits."""

import collections
import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Any

from deltasafe.io.storage import atomic_file, read_json
from generator.settings import PictureSettings, SceneSettings
from generator.surroundings.fetch import SOURCES

TEMPLATE = """# {name}: rendered {kind}

All images are rendered; no person was photographed. Results on these images may not transfer to photographs.
Each image shows one hand, no face and no other skin.

{files}

## How it was made

By `python -m generator {kind}`, {count} images, seed {seed}, with these settings (`settings.json`):

| setting | value |
|---|---|
{settings}

## Contents

| | |
|---|---|
{contents}

## License

Images, masks, meshes and recipes: CC0 1.0. They derive from:

| part | source | license |
|---|---|---|
{sources}
"""
HAND_FILES = """{count} pairs in `images/` (JPEG, {width} x {height}) and `masks/` (PNG, 255 = hand). The mask contains
the visible skin of hand and forearm, rings and watch straps, but not sleeves or held objects. A pixel is hand if at
least half of it is covered. `recipes/` holds the sampled parameters of each image, `registry.sha256` the SHA-256 of
every file."""
SCENE_FILES = """{count} scenes of a webcam {camera_height_m} m above a table at z = 0. Each scene holds:

- `image.jpg` ({width} x {height});
- `scene.json`: camera, hand height, start and goal, which are at least {clearance_m} m away from the hand horizontally;
- `recipe.json`: the sampled parameters;
- the ground truth, for evaluation only: `hand_mask.png` and `hand_mesh.npz` (`vertices_m` (V, 3), `triangles` (F, 3),
  watertight, world frame)."""


def write_datasheet(folder: pathlib.Path, recipe_pattern: str, settings: PictureSettings) -> None:
    """Write ``README.md`` for the pictures whose recipes match ``recipe_pattern``."""
    recipes = [read_json(path) for path in sorted(folder.glob(recipe_pattern))]
    values = dataclasses.asdict(settings)
    is_scenes = isinstance(settings, SceneSettings)
    text = TEMPLATE.format(
        name=folder.name,
        kind="scenes" if is_scenes else "hands",
        files=(SCENE_FILES if is_scenes else HAND_FILES).format(count=len(recipes), **values),
        count=len(recipes),
        seed=settings.seed,
        settings="\n".join(f"| `{name}` | {value} |" for name, value in values.items()),
        contents=_contents_table(recipes),
        sources=_source_table(recipes),
    )
    with atomic_file(folder / "README.md") as temporary:
        temporary.write_text(text, encoding="utf-8")


def _contents_table(recipes: list[dict[str, Any]]) -> str:
    tones = [recipe["person"]["skin"]["tone"] for recipe in recipes]
    rows = {
        "place": [recipe["place"] for recipe in recipes],
        "skin tone": ["light" if tone < 3 else "medium" if tone < 6 else "dark" for tone in tones],
        "hand": ["right" if recipe["right_hand"] else "left" for recipe in recipes],
    }
    counts = {name: sorted(collections.Counter(values).items()) for name, values in rows.items()}
    return "\n".join(f"| {name} | {', '.join(f'{v}: {n}' for v, n in pairs)} |" for name, pairs in counts.items())


def _source_table(recipes: list[dict[str, Any]]) -> str:
    names = set(_surroundings_of(recipes))
    rows = [
        "| arm model | MakeHuman's base mesh and targets | CC0 1.0 |",
        "| procedural light and surfaces | noise, by the generator | CC0 1.0 |",
    ]
    for source in SOURCES:
        used = {name for name in names if name.startswith(f"{source.name}-")}
        if used:
            rows.append(f"| {source.kind} | files of `{source.requirement}` | {source.license} |")
        names -= used
    if own := sorted(name for name in names if not name.startswith("procedural/")):
        rows.append(f"| your own surroundings | {', '.join(own)} | your license |")
    return "\n".join(rows)


def _surroundings_of(recipes: list[dict[str, Any]]) -> Iterator[str]:
    for recipe in recipes:
        if recipe["light"]["map"]:
            yield recipe["light"]["map"]
        yield from (recipe[part]["surface"]["name"] for part in ("table", "wall") if recipe[part])
