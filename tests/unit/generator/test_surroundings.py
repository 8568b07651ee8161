"""CollisionArrays: procedural ones are always there and physical, fetched ones are checked before they are kept."""

import base64
import gzip
import hashlib
import io
import pathlib
import subprocess
import tarfile
import zipfile

import numpy as np
import pytest
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json, sha256_of_file
from generator.surroundings import CollisionArrays
from generator.surroundings import fetch as fetching
from generator.surroundings.fetch import SOURCES, Source, fetch
from generator.surroundings.maps import MAPS, procedural_map
from generator.surroundings.textures import TEXTURES, procedural_texture


@pytest.mark.parametrize("kind", sorted(MAPS))
def test_procedural_light_is_positive_seeded_and_has_lamps(kind):
    one, same, other = procedural_map(kind, 3), procedural_map(kind, 3), procedural_map(kind, 4)
    assert one.shape == (256, 512, 3)
    assert one.dtype == np.float32
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    assert one.min() > 0
    assert one.max() > 4 * np.median(one)


def test_an_open_sky_is_brighter_than_the_ground():
    for seed in range(5):
        sky, ground = np.split(procedural_map("outside", seed), 2)
        assert np.median(sky) > 1.5 * np.median(ground)


@pytest.mark.parametrize("kind", sorted(TEXTURES))
def test_procedural_surfaces_are_albedos_around_their_colour(kind):
    colour = np.array([0.2, 0.4, 0.6])
    texture = procedural_texture(kind, colour, 5)
    assert texture.shape == (256, 256, 3)
    assert texture.min() > 0
    assert texture.max() <= 0.95
    assert texture.std() > 0
    mean = texture.mean(axis=(0, 1))
    assert mean / mean.sum() == pytest.approx(colour / colour.sum(), abs=0.02)


def test_without_files_all_is_procedural_and_with_files_test_pictures_avoid_what_backgrounds_show(tmp_path):
    nothing = CollisionArrays.find(tmp_path / "missing")
    assert set(nothing.map_names) == set(nothing.unseen_map_names) == {f"procedural/{kind}" for kind in MAPS}
    for folder, name in (
        ("maps", "pmndrs-city.exr"),
        ("maps", "mine.hdr"),
        ("surfaces", "oak.png"),
        ("maps", "note.txt"),
    ):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).touch()
    found = CollisionArrays.find(tmp_path)
    assert found.map_names == ("mine", "pmndrs-city")
    assert found.unseen_map_names == ("mine",)
    assert found.surface_names[0] == "oak"
    assert len(found.surface_names) == 1 + len(TEXTURES)


def test_a_surface_is_read_as_linear_albedo_and_a_broken_one_is_refused(tmp_path):
    (tmp_path / "surfaces").mkdir()
    Image.new("RGB", (2048, 8), (128, 255, 0)).save(tmp_path / "surfaces" / "plain.png")
    (tmp_path / "surfaces" / "broken.jpg").write_bytes(b"no picture")
    surroundings = CollisionArrays.find(tmp_path)
    texture = surroundings.surface("plain", (0, 0, 0), 0)
    assert texture.shape == (4, 1024, 3)
    assert texture[0, 0] == pytest.approx([0.2158605, 1, 0], abs=1e-6)
    with pytest.raises(DataError, match="fetch it again"):
        surroundings.surface("broken", (0, 0, 0), 0)
    with pytest.raises(DataError, match="python -m generator fetch"):
        surroundings.map("nowhere", 0)


def archive(folder: pathlib.Path, wheel: bool) -> pathlib.Path:
    if wheel:
        path = folder / "thing-1.0-py3-none-any.whl"
        with zipfile.ZipFile(path, "w") as zipped:
            zipped.writestr(zipfile.ZipInfo("thing/oak.png"), b"picture")
            zipped.writestr(zipfile.ZipInfo("thing/code.py"), b"raise SystemExit")
        return path
    path = folder / "thing-1.0.tgz"
    content = b"export default 'data:;base64," + base64.b64encode(b"light") + b"'"
    with gzip.GzipFile(path, "wb", mtime=0) as zipped, tarfile.open(fileobj=zipped, mode="w") as packed:
        info = tarfile.TarInfo("package/hdri/city.exr.js")
        info.size = len(content)
        packed.addfile(info, io.BytesIO(content))
    return path


def source(sha256: str, wheel: bool) -> Source:
    pattern = r"thing/(\w+)\.png" if wheel else r"package/hdri/(\w+)\.exr\.js"
    return Source(
        "mine", "thing", "1.0", sha256, 1, "surfaces" if wheel else "maps", pattern, "MIT", () if wheel else None
    )


@pytest.fixture
def client(monkeypatch):
    """Package clients that copy a file made here instead of asking a registry; returns the commands that were run."""
    commands = []

    def run(command, cwd, **_):
        commands.append(command)
        archive(pathlib.Path(cwd), wheel="pip" in command)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(fetching.subprocess, "run", run)
    monkeypatch.setattr(fetching.shutil, "which", lambda name: name)
    return commands


@pytest.mark.parametrize("wheel", [True, False])
def test_only_the_named_files_of_the_registered_archive_are_kept_once(tmp_path, monkeypatch, client, wheel):
    digest = sha256_of_file(archive(tmp_path, wheel))
    monkeypatch.setattr(fetching, "SOURCES", (source(digest, wheel),))
    out = tmp_path / "out"
    fetch(out)
    kept = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert kept == {"mine.json", "surfaces/mine-oak.png" if wheel else "maps/mine-city.exr"}
    assert set(read_json(out / "mine.json")["files"].values()) == {
        hashlib.sha256(b"picture" if wheel else b"light").hexdigest()
    }
    fetch(out)
    assert len(client) == 1, "what is there is not fetched again"


def test_another_archive_is_refused_and_leaves_nothing(tmp_path, monkeypatch, client):
    monkeypatch.setattr(fetching, "SOURCES", (source("0" * 64, True),))
    with pytest.raises(DataError, match="do not use it"):
        fetch(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_client_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(fetching, "SOURCES", (source("0" * 64, False),))
    monkeypatch.setattr(fetching.shutil, "which", lambda name: None)
    with pytest.raises(DataError, match="npm is missing"):
        fetch(tmp_path)


def test_sources_are_pinned_and_free():
    for entry in SOURCES:
        assert len(entry.sha256) == 64
        assert entry.licence.startswith(("MIT", "CC0"))
    assert len({entry.name for entry in SOURCES}) == len(SOURCES)
