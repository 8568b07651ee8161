"""The datasheet (README.md) of a generated set: commands, settings, contents, sources, licenses and limits."""

import collections
import dataclasses
import pathlib
from collections.abc import Iterator
from typing import Any

from deltasafe.io.storage import atomic_file, read_json
from deltasafe.reporting.templates import render
from generator.settings import PictureSettings, SceneSettings
from generator.surroundings.fetch import SOURCES


def write_datasheet(folder: pathlib.Path, recipe_pattern: str, settings: PictureSettings) -> None:
    """Write ``README.md`` for the pictures whose recipes match ``recipe_pattern``."""
    recipes = [read_json(path) for path in sorted(folder.glob(recipe_pattern))]
    names = set(_surroundings_of(recipes))
    sources = [source for source in SOURCES if any(name.startswith(f"{source.name}-") for name in names)]
    known = ("procedural/", *(f"{source.name}-" for source in SOURCES))
    text = render(
        "generator",
        "datasheet.md.j2",
        name=folder.name,
        kind="scenes" if isinstance(settings, SceneSettings) else "hands",
        recipes=recipes,
        settings=dataclasses.asdict(settings),
        contents=_contents(recipes),
        sources=sources,
        own=sorted(name for name in names if not name.startswith(known)),
    )
    with atomic_file(folder / "README.md") as temporary:
        temporary.write_text(text, encoding="utf-8")


def _contents(recipes: list[dict[str, Any]]) -> dict[str, list[tuple[str, int]]]:
    """Count the pictures by place, skin tone and hand."""
    tones = [recipe["person"]["skin"]["tone"] for recipe in recipes]
    rows = {
        "place": [recipe["place"] for recipe in recipes],
        "skin tone": ["light" if tone < 3 else "medium" if tone < 6 else "dark" for tone in tones],
        "hand": ["right" if recipe["right_hand"] else "left" for recipe in recipes],
    }
    return {name: sorted(collections.Counter(values).items()) for name, values in rows.items()}


def _surroundings_of(recipes: list[dict[str, Any]]) -> Iterator[str]:
    for recipe in recipes:
        if recipe["light"]["map"]:
            yield recipe["light"]["map"]
        yield from (recipe[part]["surface"]["name"] for part in ("table", "wall") if recipe[part])
