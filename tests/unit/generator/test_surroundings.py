"""Surroundings: physical range of procedural ones, verification of downloads."""

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
from generator.surroundings import Surroundings, fetch
from generator.surroundings.fetch import SOURCES, Source, fetch_surroundings
from generator.surroundings.maps import MAPS, procedural_map
from generator.surroundings.textures import TEXTURES, procedural_texture


@pytest.mark.parametrize("kind", sorted(MAPS))
def test_procedural_map_is_positive_deterministic_and_has_lamps(kind):
    one, same, other = procedural_map(kind, 3), procedural_map(kind, 3), procedural_map(kind, 4)
    assert one.shape == (256, 512, 3)
    assert one.dtype == np.float32
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    assert one.min() > 0
    assert one.max() > 4 * np.median(one)


def test_sky_is_brighter_than_ground():
    for seed in range(5):
        sky, ground = np.split(procedural_map("outside", seed), 2)
        assert np.median(sky) > 1.5 * np.median(ground)


@pytest.mark.parametrize("kind", sorted(TEXTURES))
def test_procedural_texture_is_valid_albedo_with_given_hue(kind):
    color = np.array([0.2, 0.4, 0.6])
    texture = procedural_texture(kind, color, 5)
    assert texture.shape == (256, 256, 3)
    assert texture.min() > 0
    assert texture.max() <= 0.95
    assert texture.std() > 0
    mean = texture.mean(axis=(0, 1))
    assert mean / mean.sum() == pytest.approx(color / color.sum(), abs=0.02)


def test_visible_maps_exclude_training_backgrounds_and_fall_back_to_procedural(tmp_path):
    nothing = Surroundings.find(tmp_path / "missing")
    assert set(nothing.map_names) == set(nothing.visible_map_names) == {f"procedural/{kind}" for kind in MAPS}
    for folder, name in (
        ("maps", "pmndrs-city.exr"),
        ("maps", "mine.hdr"),
        ("surfaces", "oak.png"),
        ("maps", "note.txt"),
    ):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).touch()
    found = Surroundings.find(tmp_path)
    assert found.map_names == ("mine", "pmndrs-city")
    assert found.visible_map_names == ("mine",)
    assert found.surface_names[0] == "oak"
    assert len(found.surface_names) == 1 + len(TEXTURES)


def test_surface_file_is_read_as_linear_albedo_and_broken_file_raises(tmp_path):
    (tmp_path / "surfaces").mkdir()
    Image.new("RGB", (2048, 8), (128, 255, 0)).save(tmp_path / "surfaces" / "plain.png")
    (tmp_path / "surfaces" / "broken.jpg").write_bytes(b"no picture")
    surroundings = Surroundings.find(tmp_path)
    texture = surroundings.load_surface("plain", (0, 0, 0), 0)
    assert texture.shape == (4, 1024, 3)
    assert texture[0, 0] == pytest.approx([0.2158605, 1, 0], abs=1e-6)
    with pytest.raises(DataError, match="download it again"):
        surroundings.load_surface("broken", (0, 0, 0), 0)
    with pytest.raises(DataError, match="python -m generator fetch"):
        surroundings.load_map("nowhere", 0)


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
    requirement, kind = ("thing==1.0", "surfaces") if wheel else ("@scope/thing@1.0", "maps")
    return Source("mine", requirement, sha256, 1, kind, pattern, "MIT")


@pytest.fixture
def client(monkeypatch):
    """Replace pip and npm by a fake that writes the test archive; returns the executed commands."""
    commands = []

    def run(command, cwd, **_):
        commands.append(command)
        archive(pathlib.Path(cwd), wheel="pip" in command)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(fetch.subprocess, "run", run)
    monkeypatch.setattr(fetch.shutil, "which", lambda name: name)
    return commands


@pytest.mark.parametrize("wheel", [True, False])
def test_fetch_keeps_matching_files_and_downloads_once(tmp_path, monkeypatch, client, wheel):
    digest = sha256_of_file(archive(tmp_path, wheel))
    monkeypatch.setattr(fetch, "SOURCES", (source(digest, wheel),))
    out = tmp_path / "out"
    fetch_surroundings(out)
    kept = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert kept == {"mine.json", "surfaces/mine-oak.png" if wheel else "maps/mine-city.exr"}
    assert set(read_json(out / "mine.json")["files"].values()) == {
        hashlib.sha256(b"picture" if wheel else b"light").hexdigest()
    }
    fetch_surroundings(out)
    assert len(client) == 1, "downloaded twice"


def test_archive_with_wrong_digest_is_rejected_without_output(tmp_path, monkeypatch, client):
    monkeypatch.setattr(fetch, "SOURCES", (source("0" * 64, True),))
    with pytest.raises(DataError, match="do not use"):
        fetch_surroundings(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_missing_npm_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(fetch, "SOURCES", (source("0" * 64, False),))
    monkeypatch.setattr(fetch.shutil, "which", lambda name: None)
    with pytest.raises(DataError, match="npm is missing"):
        fetch_surroundings(tmp_path)


def test_sources_are_pinned_and_freely_licensed():
    for entry in SOURCES:
        assert len(entry.sha256) == 64
        assert entry.license.startswith(("MIT", "CC0"))
    assert len({entry.name for entry in SOURCES}) == len(SOURCES)
