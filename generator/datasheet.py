"""The README.md of what was made: how, from what, under which licence, and what it does not show."""

import collections
import dataclasses
import pathlib
from collections.abc import Iterable
from typing import Any

from deltasafe.io.storage import atomic_file, read_json
from generator.settings import HandSetSettings, PictureSettings, SceneSettings
from generator.surroundings.fetch import SOURCES

__all__ = ["write_hands_datasheet", "write_scenes_datasheet"]

LIMITS = (
    "Everything here was rendered; nobody was photographed. What is measured on these pictures is a statement about\n"
    "these pictures. One hand a picture, no face, no other bare skin."
)
ARM = "| arm model | MakeHuman's base mesh and targets | CC0 1.0 |"
OWN = "| procedural light and surfaces | made of noise by the generator | CC0 1.0 |"


def write_hands_datasheet(folder: pathlib.Path, settings: HandSetSettings) -> None:
    """Write ``README.md`` beside the pictures, from their recipes."""
    recipes = [read_json(path) for path in sorted((folder / "recipes").glob("*.json"))]
    text = f"""# {folder.name}: rendered hands

{LIMITS}

{len(recipes)} pairs in `images/` (JPEG, {settings.width} x {settings.height}) and `masks/` (PNG, 255 = visible skin of
hand and forearm, rings and straps included; sleeves and things held are background; a pixel is hand where at least half
of it is covered). `recipes/` says how each picture was drawn, `registry.sha256` holds the SHA-256 of every file.

{_command("hands", len(recipes), settings)}

{_contents(recipes)}

{_sources(recipes)}
"""
    _write(folder / "README.md", text)


def write_scenes_datasheet(folder: pathlib.Path, settings: SceneSettings) -> None:
    """Write ``README.md`` beside the scenes, from their recipes."""
    recipes = [read_json(path) for path in sorted(folder.glob("scene_*/recipe.json"))]
    text = f"""# {folder.name}: rendered scenes

{LIMITS}

{len(recipes)} scenes as logged by a webcam {settings.camera_height_m} m above a table at z = 0: `image.jpg`
({settings.width} x {settings.height}), `scene.json` (camera, hand height, start and goal, which are at least
{settings.clearance_m} m away from the hand as seen from above), `recipe.json` (how it was drawn), and the ground truth,
for judging only: `hand_mask.png`, `hand_mesh.npz` (`vertices_m` (V, 3), `triangles` (F, 3), watertight, world frame).

{_command("scenes", len(recipes), settings)}

{_contents(recipes)}

{_sources(recipes)}
"""
    _write(folder / "README.md", text)


def _command(kind: str, count: int, settings: PictureSettings) -> str:
    values = "\n".join(f"| `{name}` | {value} |" for name, value in dataclasses.asdict(settings).items())
    return f"""## How it was made

By `python -m generator {kind}`, {count} pictures, seed {settings.seed}, with these settings (`settings.json`):

| setting | value |
|---|---|
{values}"""


def _contents(recipes: list[dict[str, Any]]) -> str:
    tones = [recipe["person"]["skin"]["tone"] for recipe in recipes]
    thirds = collections.Counter("light" if tone < 3 else "medium" if tone < 6 else "dark" for tone in tones)
    rows = {
        "place": collections.Counter(recipe["place"] for recipe in recipes),
        "skin tone": thirds,
        "hand": collections.Counter("right" if recipe["right_hand"] else "left" for recipe in recipes),
    }
    lines = "\n".join(f"| {name} | {_counted(counts)} |" for name, counts in rows.items())
    return f"""## What it holds

| | |
|---|---|
{lines}"""


def _counted(counts: collections.Counter[str]) -> str:
    return ", ".join(f"{value}: {count}" for value, count in sorted(counts.items()))


def _sources(recipes: list[dict[str, Any]]) -> str:
    names = set(_names(recipes))
    used = [source for source in SOURCES if any(name.startswith(f"{source.name}-") for name in names)]
    rows = [f"| {source.kind} | files of `{source.package}` {source.version} | {source.licence} |" for source in used]
    table = "\n".join([ARM, OWN, *rows])
    known = tuple(f"{source.name}-" for source in SOURCES)
    own = sorted(name for name in names if not name.startswith((*known, "procedural/")))
    note = f"\n\nYour own surroundings, under your licence: {', '.join(own)}." if own else ""
    return f"""## Licence

Pictures, masks, meshes and descriptions: CC0 1.0. They derive from:

| part | source | licence |
|---|---|---|
{table}{note}"""


def _names(recipes: list[dict[str, Any]]) -> Iterable[str]:
    for recipe in recipes:
        for part, key in (("light", "map"), ("ground", "surface"), ("wall", "surface")):
            if recipe[part] and recipe[part][key]:
                yield recipe[part][key]


def _write(path: pathlib.Path, text: str) -> None:
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
