"""What lies around the hand: environment maps and surfaces, fetched once or made of noise.

Names: ``procedural/KIND`` is always there; any other name is a file in the folder of fetched (or a user's own)
surroundings: ``maps/NAME.exr`` or ``.hdr`` by latitude and longitude, ``surfaces/NAME.jpg`` or ``.png``.
"""

import dataclasses
import functools
import pathlib

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from deltasafe.errors import DataError
from generator.backend import load_mitsuba
from generator.skin.palette import linear
from generator.surroundings.maps import MAPS, procedural_map
from generator.surroundings.textures import TEXTURES, procedural_texture

__all__ = ["SEEN_IN_BACKGROUNDS", "CollisionArrays"]

PROCEDURAL = "procedural/"
# environment maps of which datasets/backgrounds shows views: pictures made for testing must not show them
SEEN_IN_BACKGROUNDS = "pmndrs-"
LONGEST_SIDE = 1024
MAP_SUFFIXES, SURFACE_SUFFIXES = (".exr", ".hdr"), (".jpg", ".jpeg", ".png")


@dataclasses.dataclass(frozen=True)
class CollisionArrays:
    """Environment maps and surfaces by name.

    Attributes:
        map_files: fetched or own environment maps.
        surface_files: fetched or own textures.
    """

    map_files: dict[str, pathlib.Path] = dataclasses.field(default_factory=dict)
    surface_files: dict[str, pathlib.Path] = dataclasses.field(default_factory=dict)

    @classmethod
    def find(cls, folder: str | pathlib.Path) -> "CollisionArrays":
        """All that lies in ``folder``; nothing but the procedural ones if it does not exist."""
        folder = pathlib.Path(folder)
        return cls(_files(folder / "maps", MAP_SUFFIXES), _files(folder / "surfaces", SURFACE_SUFFIXES))

    @property
    def map_names(self) -> tuple[str, ...]:
        """Maps to light with: the fetched ones, or if there are none, the procedural ones."""
        return tuple(self.map_files) or _procedural(MAPS)

    @property
    def unseen_map_names(self) -> tuple[str, ...]:
        """Maps to be seen behind the hand: none that the augmentation's backgrounds show."""
        unseen = tuple(name for name in self.map_files if not name.startswith(SEEN_IN_BACKGROUNDS))
        return unseen or _procedural(MAPS)

    @property
    def surface_names(self) -> tuple[str, ...]:
        """All surfaces, procedural ones included."""
        return (*self.surface_files, *_procedural(TEXTURES))

    def map(self, name: str, seed: int) -> NDArray[np.float32]:
        """(H, W, 3) radiance; ``seed`` is that of a procedural map.

        Raises:
            DataError: there is no such map.
        """
        if name.startswith(PROCEDURAL):
            return procedural_map(name.removeprefix(PROCEDURAL), seed)
        return _read_map(_known(self.map_files, name))

    def surface(self, name: str, colour: ArrayLike, seed: int) -> NDArray[np.float64]:
        """(H, W, 3) linear texture; ``colour`` (3,) and ``seed`` are those of a procedural one.

        Raises:
            DataError: there is no such surface.
        """
        if name.startswith(PROCEDURAL):
            return procedural_texture(name.removeprefix(PROCEDURAL), colour, seed)
        return _read_surface(_known(self.surface_files, name))


def _procedural(kinds: dict) -> tuple[str, ...]:
    return tuple(PROCEDURAL + kind for kind in kinds)


def _files(folder: pathlib.Path, suffixes: tuple[str, ...]) -> dict[str, pathlib.Path]:
    if not folder.is_dir():
        return {}
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in suffixes}


def _known(files: dict[str, pathlib.Path], name: str) -> pathlib.Path:
    if name not in files:
        raise DataError(name, "is not among the surroundings; fetch them with: python -m generator fetch")
    return files[name]


@functools.lru_cache(maxsize=4)
def _read_map(path: pathlib.Path) -> NDArray[np.float32]:
    mitsuba = load_mitsuba()
    try:
        radiance = np.array(mitsuba.Bitmap(str(path)), dtype=np.float32)[..., :3]
    except RuntimeError as error:
        raise DataError(path, f"is no readable environment map ({error}); fetch it again") from error
    return np.nan_to_num(radiance)


@functools.lru_cache(maxsize=8)
def _read_surface(path: pathlib.Path) -> NDArray[np.float64]:
    try:
        with Image.open(path) as opened:
            opened.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
            return linear(np.asarray(opened.convert("RGB")))
    except OSError as error:
        raise DataError(path, f"is no readable picture ({error}); fetch it again") from error
