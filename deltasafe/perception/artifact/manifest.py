"""`manifest.json` of a frozen ensemble. Its content is untrusted until it has been validated."""

import dataclasses
import pathlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from deltasafe.compute.code_digest import digest_of_package
from deltasafe.errors import ArtifactError, DataError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json
from deltasafe.perception.data.dataset_info import DatasetInfo
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member

FORMAT_VERSION = 4
"""Version 2 applies the temperature of `calibration.json`; in version 1 it was always 1. Since version 3 the ONNX
program accepts images of any size and also returns the members' logits. Version 4 averages over the scales of
``inference``; before, there was one."""

_FIRST_WITH_SCALES = 4

_MAX_MEMBERS = 1000


def new_manifest(
    members: Sequence[Member],
    names: Sequence[str],
    inference: InferenceSettings,
    provenance: Mapping[str, str],
    info: DatasetInfo,
) -> dict[str, Any]:
    """Build the manifest of ``members``, stored in files ``names``; the digests of all files are still missing."""
    return {
        "format_version": FORMAT_VERSION,
        "n_members": len(members),
        "members": list(names),
        "seeds": [member.seed for member in members],
        "class": f"p_occupied: probability that a pixel shows {info.marked_with_article} "
        f"(masks: 255 = {info.singular})",
        **({} if info.is_default else {"dataset": dataclasses.asdict(info)}),
        "preprocessing": "RGB uint8; scaled to the inference size at each scale (area or bilinear); ImageNet "
        "statistics are applied inside the network",
        "network": dataclasses.asdict(members[0].network_settings),
        "inference": {**dataclasses.asdict(inference), "scales": list(inference.scales)},  # as JSON reads it
        "provenance": {"data": members[0].record["data_digest"], "code": digest_of_package(), **provenance},
    }


def load_manifest(folder: pathlib.Path) -> dict[str, Any]:
    """Read the manifest of a frozen ensemble and validate its form. The digests are not compared with the files.

    Raises:
        ArtifactError: the manifest is missing, malformed, or of an unknown format version.
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
    if problems := _problems(manifest):
        raise ArtifactError(path, f"{problems[0]}; pull the artifact again")
    return dict(manifest)


def info_of_manifest(folder: pathlib.Path, manifest: Mapping[str, Any]) -> DatasetInfo:
    """Return what the test images of the ensemble show.

    Raises:
        ArtifactError: the entry is invalid.
    """
    path = folder / "manifest.json"
    try:
        return DatasetInfo.from_record(manifest.get("dataset", {}), path)
    except DataError as error:
        raise ArtifactError(path, f"has no valid entry dataset ({error.reason}); pull the artifact again") from error


def settings_of_manifest(
    folder: pathlib.Path, manifest: Mapping[str, Any]
) -> tuple[NetworkSettings, InferenceSettings]:
    """Return the settings of network and inference.

    Raises:
        ArtifactError: they are missing or invalid.
    """
    try:
        network = NetworkSettings.from_record(manifest["network"])
        return network, inference_of_manifest(manifest)
    except (KeyError, TypeError, ValueError) as error:
        reason = repr(error) if isinstance(error, KeyError) else error
        raise ArtifactError(
            folder / "manifest.json", f"has no valid settings ({reason}); pull the artifact again"
        ) from error


def inference_of_manifest(manifest: Mapping[str, Any]) -> InferenceSettings:
    """Return the settings of inference; before version 4 there was one scale.

    Raises:
        KeyError, TypeError, ValueError: they are missing or invalid.
    """
    record = manifest["inference"]
    if manifest["format_version"] < _FIRST_WITH_SCALES and isinstance(record, Mapping):
        record = {**record, "scales": [1.0]}
    return from_json(InferenceSettings, record)


def _problems(manifest: Mapping[str, Any]) -> list[str]:
    files, members = manifest.get("files"), manifest.get("members")
    if not isinstance(files, dict):
        return [f"has no digests of files, but {files!r:.60}"]
    problems = []
    for name, digest in files.items():
        if name in ("", ".", "..", "manifest.json") or pathlib.PurePath(name).name != name or not name.isprintable():
            problems.append(f"names a file outside of the folder, or an invalid one: {name!r:.60}")
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
            problems.append(f"has no SHA-256 for {name!r:.60}, but {digest!r:.60}")
    if not isinstance(members, list) or not all(isinstance(name, str) for name in members) or not members:
        return [*problems, f"has no list of members, but {members!r:.60}"]
    n_members = manifest.get("n_members")
    if type(n_members) is not int or n_members != len(members) or len({*members}) != len(members):
        problems.append(f"has {len({*members})} distinct members, but n_members is {n_members!r:.60}")
    if len(members) > _MAX_MEMBERS:
        problems.append(f"has {len(members)} members, more than {_MAX_MEMBERS}")
    if unlisted := {*members, "calibration.json", "golden.npz", "ensemble.onnx"} - set(files):
        problems.append(f"has no digest for {sorted(unlisted)}")
    return problems
