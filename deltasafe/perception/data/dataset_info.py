"""`dataset.json` of a set of labeled images: what its masks mark and how they are read, and the gate of ensembles.

Without the file, the masks mark hands. Folders that are made from a set (augmented images, report, ensemble, occupancy
fields) carry its information on, so that reports and figures name the obstacle.
"""

import dataclasses
import pathlib
import re
from typing import Any

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json, write_json
from deltasafe.perception.settings import GateThresholds
from deltasafe.setting_ranges import check_choice, check_range

_FILE = "dataset.json"
_IDENTIFIER = re.compile(r"[a-z][a-z0-9_]{0,49}")
_ORIGINS = ("", "rendered", "photographs")


@dataclasses.dataclass(frozen=True)
class SetOptions:
    """How the masks of a set are read: further keys of ``dataset.json``.

    Attributes:
        masks_drawn_on: for photographs with an EXIF orientation: ``upright`` if the masks fit the picture as viewers
            show it, ``stored`` if they fit the stored pixels. Empty: the size of the mask decides, where it can.
        large_masks: masks that cover most of their image are right, and not inverted.
    """

    masks_drawn_on: str = ""
    large_masks: bool = False

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "SetOptions":
        """Read ``dataset.json`` in ``folder``; the file may be missing.

        Raises:
            DataError: the file is malformed, or a value is invalid.
        """
        path = pathlib.Path(folder) / _FILE
        record = read_json(path) if path.is_file() else {}
        known = {"masks_drawn_on": ("", "upright", "stored"), "large_masks": (False, True)}
        found = {key: record[key] for key in known if key in record} if isinstance(record, dict) else {}
        for key, value in found.items():
            if value not in known[key]:
                raise DataError(path, f"must hold one of {known[key]} for {key}, got {value!r:.60}")
        return cls(**found)


@dataclasses.dataclass(frozen=True)
class DatasetInfo:
    """What a set of labeled images shows. Only ``obstacle`` is needed for another class than a hand.

    Attributes:
        obstacle: identifier of the class, of lower-case letters, digits and underscores, e.g. ``coffee_cup``.
        singular, plural: its display names, e.g. ``coffee cup``. Default: the identifier with spaces, and with an s.
        marked: what the masks mark. Default: ``singular``; for hands ``hand or forearm``.
        images: ``rendered``, ``photographs``, or empty if it is not known.
        hand_recipe: whether the augmentation changes skin tones and adds clothing. Default: for hands only.
        coverage: least and greatest fraction of the pixels that obstacles may cover in the augmented set.
        gate: thresholds for freezing an ensemble; None: those of the preset. Settings of a run take precedence.
    """

    obstacle: str = "hand"
    singular: str = ""
    plural: str = ""
    marked: str = ""
    images: str = ""
    hand_recipe: bool | None = None
    coverage: tuple[float, ...] = (0.02, 0.6)
    gate: GateThresholds | None = None

    def __post_init__(self) -> None:
        if not _IDENTIFIER.fullmatch(self.obstacle):
            raise SettingsError(
                "obstacle must be an identifier of lower-case letters, digits and underscores, for example coffee_cup, "
                f"got {self.obstacle!r:.60}"
            )
        is_hand = self.obstacle == "hand"
        singular = self.singular or self.obstacle.replace("_", " ")
        defaults = {
            "singular": singular,
            "plural": self.plural or f"{singular}s",
            "marked": self.marked or ("hand or forearm" if is_hand else singular),
            "hand_recipe": is_hand if self.hand_recipe is None else self.hand_recipe,
            "coverage": tuple(self.coverage),
        }
        for name, value in defaults.items():
            object.__setattr__(self, name, value)
        for name in ("singular", "plural", "marked"):
            text = getattr(self, name)
            if not text.isprintable() or text != text.strip() or len(text) > 60:
                raise SettingsError(f"{name} must be a printable name of at most 60 characters, got {text!r:.80}")
        check_choice(self, _ORIGINS, "images")
        check_range(self, "[0, 1]", "coverage")
        if len(self.coverage) != 2 or self.coverage[0] >= self.coverage[1]:
            raise SettingsError(f"coverage must be two ascending fractions, got {self.coverage}")

    @property
    def with_article(self) -> str:
        """The singular with its indefinite article."""
        return _with_article(self.singular)

    @property
    def marked_with_article(self) -> str:
        """What the masks mark, with its indefinite article."""
        return _with_article(self.marked)

    @property
    def capitalized(self) -> str:
        """The singular as the first word of a sentence."""
        return self.singular[0].upper() + self.singular[1:]

    @property
    def is_default(self) -> bool:
        """Whether this is the information of a set without the file."""
        return self == HANDS

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "DatasetInfo":
        """Read ``dataset.json`` in ``folder``; without the file, the obstacle is a hand.

        Raises:
            DataError: the file is malformed, or a value is invalid.
        """
        path = pathlib.Path(folder) / _FILE
        record = read_json(path) if path.is_file() else {}
        if isinstance(record, dict):
            record = {key: value for key, value in record.items() if key not in _OPTIONS}
        return cls.from_record(record, path)

    @classmethod
    def from_record(cls, record: Any, path: pathlib.Path) -> "DatasetInfo":
        """Convert the JSON form, which was read from ``path``.

        Raises:
            DataError: it is malformed, or a value is invalid.
        """
        try:
            found: DatasetInfo = from_json(cls, record)
        except (TypeError, ValueError) as error:
            raise DataError(path, f"is invalid ({error}); see docs/reference/formats.md, or remove it") from error
        return found

    def save(self, folder: pathlib.Path, options: SetOptions | None = None) -> None:
        """Write ``dataset.json`` to ``folder``, unless it would say the default."""
        record = {} if self.is_default else dataclasses.asdict(self)
        if options is not None:
            record |= dataclasses.asdict(options)
        if record:
            write_json(folder / _FILE, record)

    def require_same_obstacle(self, other: "DatasetInfo", path: pathlib.Path, role: str) -> None:
        """Check that the set at ``path`` shows the same obstacle as ``other``, the set with the ``role``.

        Raises:
            DataError: it shows another one.
        """
        if self.obstacle != other.obstacle:
            raise DataError(
                path,
                f"shows the obstacle {self.obstacle!r}, the {role} set {other.obstacle!r}; "
                "give sets of one obstacle, which dataset.json names (default: hand)",
            )


_OPTIONS = [field.name for field in dataclasses.fields(SetOptions)]
HANDS = DatasetInfo()
"""The information of a set without ``dataset.json``."""


def _with_article(noun: str) -> str:
    return f"{'an' if noun[0].lower() in 'aeiou' else 'a'} {noun}"
