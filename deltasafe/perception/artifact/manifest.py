"""`manifest.json` of a frozen ensemble, read by somebody who does not trust it."""

import pathlib
import re
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import ArtifactError, DataError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json
from deltasafe.perception.settings import InferenceSettings, NetworkSettings

__all__ = ["FORMAT_VERSION", "described", "read_manifest"]

FORMAT_VERSION = 3
"""2 applies the temperature of `calibration.json`; in version 1 it was always 1. Since 3, the ONNX program takes images
of any size and gives the members' logits as well."""

_MOST_MEMBERS = 1000


def read_manifest(folder: pathlib.Path) -> dict[str, Any]:
    """The manifest of a frozen ensemble, its form checked; whether it speaks the truth about the files is not.

    Raises:
        ArtifactError: it is missing, is not JSON, of an unknown format, or names what cannot be.
    """
    path = folder / "manifest.json"
    try:
        manifest = read_json(path)
    except DataError as error:
        raise ArtifactError(error.path, error.reason) from None
    version = manifest.get("format_version") if isinstance(manifest, dict) else None
    if type(version) is not int or not 1 <= version <= FORMAT_VERSION:
        raise ArtifactError(
            path, f"has format_version {version!r}, this version reads 1 to {FORMAT_VERSION}; pull the artifact again"
        )
    for problem in _problems(manifest):
        raise ArtifactError(path, f"{problem}; pull the artifact again")
    return dict(manifest)


def described(folder: pathlib.Path, manifest: Mapping[str, Any]) -> tuple[NetworkSettings, InferenceSettings]:
    """The network of all members and the resolution at which they look.

    Raises:
        ArtifactError: the manifest describes none.
    """
    try:
        network = from_json(NetworkSettings, {"atrous_rates": [12, 24, 36], **manifest["network"]})
        return network, from_json(InferenceSettings, manifest["inference"])
    except (KeyError, TypeError, ValueError) as error:
        reason = repr(error) if isinstance(error, KeyError) else error
        raise ArtifactError(
            folder / "manifest.json", f"describes no network ({reason}); pull the artifact again"
        ) from error


def _problems(manifest: Mapping[str, Any]) -> list[str]:
    files, members = manifest.get("files"), manifest.get("members")
    if not isinstance(files, dict):
        return [f"names no files and digests, but {files!r:.60}"]
    found = []
    for name, digest in files.items():
        if name in ("", ".", "..", "manifest.json") or pathlib.PurePath(name).name != name or not name.isprintable():
            found.append(f"names a file outside of the folder, or none: {name!r:.60}")
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
            found.append(f"gives no SHA-256 for {name!r:.60}: {digest!r:.60}")
    if not isinstance(members, list) or not all(isinstance(name, str) for name in members) or not members:
        return [*found, f"names no members, but {members!r:.60}"]
    n_members = manifest.get("n_members")
    if type(n_members) is not int or n_members != len(members) or len({*members}) != len(members):
        found.append(f"names {len({*members})} members of {n_members!r:.60}")
    if len(members) > _MOST_MEMBERS:
        found.append(f"names {len(members)} members, of at most {_MOST_MEMBERS}")
    if unlisted := {*members, "calibration.json", "golden.npz", "ensemble.onnx"} - set(files):
        found.append(f"lists no digest for {sorted(unlisted)}")
    return found
