"""Surroundings of the hand: environment maps and surface textures, downloaded once or procedural.

The names ``procedural/KIND`` always exist. Any other name is a file in the folder of downloaded (or the user's own)
surroundings: an equirectangular map ``maps/NAME.exr`` or ``.hdr``, or a texture ``surfaces/NAME.jpg`` or ``.png``.
"""

import dataclasses
import functools
import pathlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from deltasafe.errors import DataError
from generator.aliases import Array
from generator.backend import load_mitsuba
from generator.skin.palette import srgb_to_linear
from generator.surroundings.maps import MAPS, procedural_map
from generator.surroundings.textures import TEXTURES, procedural_texture

__all__ = ["Surroundings"]

PROCEDURAL = "procedural/"
# prefix of the maps that datasets/backgrounds shows; training uses those, so test images must not show them
TRAINING_MAPS_PREFIX = "pmndrs-"
MAX_SIDE_PX = 1024
MAP_SUFFIXES, SURFACE_SUFFIXES = (".exr", ".hdr"), (".jpg", ".jpeg", ".png")


@dataclasses.dataclass(frozen=True)
class Surroundings:
    """Environment maps and surface textures by name.

    Attributes:
        map_files: downloaded or own environment maps.
        surface_files: downloaded or own textures.
    """

    map_files: dict[str, pathlib.Path] = dataclasses.field(default_factory=dict)
    surface_files: dict[str, pathlib.Path] = dataclasses.field(default_factory=dict)

    @classmethod
    def find(cls, folder: str | pathlib.Path) -> "Surroundings":
        """List the files in ``folder``; without the folder, only procedural surroundings are available."""
        folder = pathlib.Path(folder)
        return cls(_files(folder / "maps", MAP_SUFFIXES), _files(folder / "surfaces", SURFACE_SUFFIXES))

    @property
    def map_names(self) -> tuple[str, ...]:
        """Maps for lighting: the files, or the procedural maps if there are no files."""
        return tuple(self.map_files) or _procedural(MAPS)

    @property
    def visible_map_names(self) -> tuple[str, ...]:
        """Maps that may be visible behind the hand: files that training does not show, or the procedural maps."""
        names = tuple(name for name in self.map_files if not name.startswith(TRAINING_MAPS_PREFIX))
        return names or _procedural(MAPS)

    @property
    def surface_names(self) -> tuple[str, ...]:
        """All surface textures, procedural ones included."""
        return (*self.surface_files, *_procedural(TEXTURES))

    def load_map(self, name: str, seed: int) -> NDArray[np.float32]:
        """Return the radiance (H, W, 3) of a map; ``seed`` matters for procedural maps only.

        Raises:
            DataError: there is no such map, or its file cannot be read.
        """
        if name.startswith(PROCEDURAL):
            return procedural_map(name.removeprefix(PROCEDURAL), seed)
        return _read_map(_path_of(self.map_files, name))

    def load_surface(self, name: str, color: ArrayLike, seed: int) -> Array:
        """Return a linear texture (H, W, 3); ``color`` (3,) and ``seed`` matter for procedural textures only.

        Raises:
            DataError: there is no such texture, or its file cannot be read.
        """
        if name.startswith(PROCEDURAL):
            return procedural_texture(name.removeprefix(PROCEDURAL), color, seed)
        return _read_surface(_path_of(self.surface_files, name))


def _procedural(kinds: Iterable[str]) -> tuple[str, ...]:
    return tuple(PROCEDURAL + kind for kind in kinds)


def _files(folder: pathlib.Path, suffixes: tuple[str, ...]) -> dict[str, pathlib.Path]:
    return {path.stem: path for path in sorted(folder.glob("*")) if path.suffix.lower() in suffixes}


def _path_of(files: dict[str, pathlib.Path], name: str) -> pathlib.Path:
    if name not in files:
        raise DataError(name, "is not among the surroundings; download them with: python -m generator fetch")
    return files[name]


@functools.lru_cache(maxsize=4)
def _read_map(path: pathlib.Path) -> NDArray[np.float32]:
    mitsuba = load_mitsuba()
    try:
        radiance = np.array(mitsuba.Bitmap(str(path)), dtype=np.float32)[..., :3]
    except RuntimeError as error:
        raise DataError(path, f"is not a readable environment map ({error}); download it again") from error
    return np.nan_to_num(radiance)


@functools.lru_cache(maxsize=8)
def _read_surface(path: pathlib.Path) -> Array:
    try:
        with Image.open(path) as opened:
            opened.thumbnail((MAX_SIDE_PX, MAX_SIDE_PX))
            return srgb_to_linear(np.asarray(opened.convert("RGB")))
    except OSError as error:
        raise DataError(path, f"is not a readable image ({error}); download it again") from error
