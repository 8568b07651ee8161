"""One rule for the files of a folder that a person filled: which are clutter, which are images, which names work."""

import dataclasses
import os
import pathlib

from deltasafe.errors import DataError

IMAGE_SUFFIXES = (
    *(".jpg", ".jpeg", ".jfif", ".png", ".webp", ".bmp"),
    *(".tif", ".tiff", ".heic", ".heif", ".avif"),
)
"""Of files that are read as images; upper case counts as well."""

_CLUTTER = {"thumbs.db", "ehthumbs.db", "desktop.ini", "icon\r", "__macosx", "@eadir", "$recycle.bin"}
"""What desktops and file servers add to a folder, in lower case; hidden files start with a dot."""


@dataclasses.dataclass(frozen=True)
class FolderEntries:
    """What a folder holds, except clutter.

    Attributes:
        images: files with a suffix of ``IMAGE_SUFFIXES``, sorted.
        others: subfolders and all other files, sorted.
    """

    images: tuple[pathlib.Path, ...]
    others: tuple[pathlib.Path, ...]

    @classmethod
    def of(cls, folder: pathlib.Path) -> "FolderEntries":
        """List a folder; its subfolders are not entered."""
        found = sorted(path for path in folder.iterdir() if not is_clutter(path.name))
        images = tuple(path for path in found if path.suffix.lower() in IMAGE_SUFFIXES and not path.is_dir())
        return cls(images, tuple(path for path in found if path not in set(images)))

    @property
    def ignored(self) -> str:
        """Name the entries that are no images, for a log; empty if there are none."""
        names = [f"{path.name}/" if path.is_dir() else path.name for path in self.others]
        more = f" and {len(names) - 10} more" if len(names) > 10 else ""
        return f"{', '.join(names[:10])}{more}"


def is_clutter(*names: str) -> bool:
    """Return whether a file is hidden or made by a desktop, or lies in such a folder.

    Args:
        names: of the file, and of the folders that it lies in.
    """
    return any(name.startswith(".") or name.lower() in _CLUTTER for name in names)


def require_utf8_name(path: pathlib.Path) -> pathlib.Path:
    """Return ``path`` if its name is UTF-8; another one cannot be stored in a report or a digest.

    Raises:
        DataError: shows the bytes that are no UTF-8 as ``\\xNN``.
    """
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        shown = os.fsencode(path).decode("utf-8", "backslashreplace")
        raise DataError(shown, "has a name that is not UTF-8; rename it") from None
    return path
