"""One rule says which files of a folder are clutter of desktops, which are images, and what is ignored by name."""

import pathlib

import pytest

from deltasafe.errors import DataError
from deltasafe.io.folder_entries import FolderEntries, is_clutter, require_utf8_name


@pytest.mark.parametrize(
    "name", ["._x.jpg", ".DS_Store", "Thumbs.db", "THUMBS.DB", "desktop.ini", "__MACOSX", "Icon\r"]
)
def test_files_of_desktops_are_clutter(name: str) -> None:
    assert is_clutter(name)
    assert is_clutter(name, "images")


def test_images_are_no_clutter_whatever_their_name() -> None:
    assert not is_clutter("thumbs.db.jpg", "set", "Icon")


def test_folder_is_divided_into_images_and_others(tmp_path: pathlib.Path) -> None:
    for name in ("b.JPG", "a.webp", "c.HEIC", "notes.txt", "._b.JPG", "Thumbs.db", "d.jfif"):
        (tmp_path / name).touch()
    for name in ("more", "folder.png", "@eaDir"):
        (tmp_path / name).mkdir()
    entries = FolderEntries.of(tmp_path)
    assert [path.name for path in entries.images] == ["a.webp", "b.JPG", "c.HEIC", "d.jfif"]
    assert entries.ignored == "folder.png/, more/, notes.txt"


def test_ignored_entries_are_counted_if_they_are_many(tmp_path: pathlib.Path) -> None:
    for i in range(13):
        (tmp_path / f"{i:02d}.txt").touch()
    assert FolderEntries.of(tmp_path).ignored.endswith("09.txt and 3 more")


def test_unicode_names_are_accepted_and_other_bytes_refused() -> None:
    require_utf8_name(pathlib.Path("Hände/手.jpg"))
    with pytest.raises(DataError, match=r"b\\xff\.jpg: has a name that is not UTF-8"):
        require_utf8_name(pathlib.Path("Hände/b\udcff.jpg"))
