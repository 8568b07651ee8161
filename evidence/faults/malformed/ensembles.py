"""Corruptions of frozen ensembles: exchanged files, false manifests, and damaged content with matching digests."""

import hashlib
import json
import os
import pathlib
from random import Random
from typing import Any

import numpy as np

from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble
from deltasafe.perception.artifact.manifest import FORMAT_VERSION
from evidence.faults.malformed.documents import document_changes, field_changes, with_field
from evidence.faults.malformed.files import (
    at,
    cases_of,
    edited,
    file_changes,
    filled,
    linked_outside,
    prefixed,
    truncated,
    with_text,
)
from evidence.faults.malformed.packed import array_changes, with_array
from evidence.faults.malformed.weights import weight_changes
from evidence.faults.rejection import Case, Change, Corruption, InputKind, rewrite

MANIFEST, CALIBRATION, GOLDEN, PROGRAM = "manifest.json", "calibration.json", "golden.npz", "ensemble.onnx"
WEIGHTS = "member-0.safetensors"
REQUIRED = ("format_version", "files", "members", "n_members", "network", "inference")
CALIBRATED = (
    *("n_images", "n_members", "pixel_accuracy", "miou", "brier", "nll", "expected_calibration_error"),
    *("smallest_supported_delta", "temperature"),
)
CALIBRATION_VALUES = (
    *(("n_images", value) for value in (0, -5)),
    *(("n_members", value) for value in (2, 0)),
    ("pixel_accuracy", 1.5),
    ("miou", -0.1),
    ("brier", 2.0),
    ("expected_calibration_error", 7.0),
    ("level", 95.0),
    *(("smallest_supported_delta", value) for value in (0.0, 1.0, -0.05)),
    *(("temperature", value) for value in (0.0, -1.0)),
    ("surplus", 1.0),
)
MANIFEST_VALUES: dict[str, list[Any]] = {
    "network.architecture": ["unet", "", None, 3, "../unet"],
    "network.backbone": ["vgg", None, ["resnet50"], "os.system"],
    "network.pyramid_channels": [0, -1, 10**12, 16.5, "16", None, True],
    "network.atrous_rates": [[], [0], [10**9], ["12"], 12, None],
    "network.pretrained": ["yes", None, 1],
    "network.layers": [5],
    "inference.width": [0, -64, 10**9, "64", 64.5, None],
    "inference.height": [31, 10**9, True],
    "inference.depth": [3],
}


def ensemble_cases(frozen: pathlib.Path) -> list[Case]:
    """A frozen ensemble, as `load_ensemble` and ``deltasafe verify`` read it."""
    kind = InputKind(
        "ensemble",
        frozen,
        lambda given, out: golden_difference(load_ensemble(given)),
        lambda given, out: ["verify", str(given)],
    )
    names = sorted(path.name for path in frozen.iterdir())
    corruptions: dict[str, Corruption] = {}
    for name in names:
        corruptions |= {f"{name}: {state}": at(name, change) for state, change in file_changes().items()}
    corruptions |= prefixed(MANIFEST, _manifests(frozen), lambda change: _renamed_folder(at(MANIFEST, change)))
    contents = {
        CALIBRATION: _calibrations(frozen),
        WEIGHTS: weight_changes(),
        GOLDEN: {**array_changes(frozen / GOLDEN), **_golden_images()},
        PROGRAM: _programs(),
    }
    for name, changes in contents.items():
        for state, change in changes.items():
            corruptions[f"{name} with a matching digest: {state}"] = _with_digest(name, change)
    return cases_of(kind, {**corruptions, **_folders(names)})


def _with_digest(name: str, change: Change) -> Corruption:
    """Change a file and update its digest in the manifest."""

    def corrupt(given: pathlib.Path, random: Random) -> str:
        change(given / name, random)
        if (given / name).is_file() and os.access(given / name, os.R_OK):
            manifest = json.loads((given / MANIFEST).read_text())
            manifest["files"][name] = hashlib.sha256((given / name).read_bytes()).hexdigest()
            rewrite(given / MANIFEST, json.dumps(manifest).encode())
        return name

    return _renamed_folder(corrupt)


def _renamed_folder(corruption: Corruption, name: str = "pulled") -> Corruption:
    """Rename the folder, whose name contains the digest of its content, and leave a link to it."""

    def corrupt(given: pathlib.Path, random: Random) -> str | None:
        culprit = corruption(given, random)
        target = given.rename(given.with_name(name))
        given.symlink_to(target.name)
        return culprit

    return corrupt


def _manifests(frozen: pathlib.Path) -> dict[str, Change]:
    manifest = json.loads((frozen / MANIFEST).read_text())
    files, digest = manifest["files"], "0" * 64
    changes = {**document_changes(), **dict(field_changes(manifest, REQUIRED))}
    for name in ("../secret", "/etc/passwd", "..", ".", "", "a/b", "a\0b", "a\nb", MANIFEST, "./golden.npz"):
        changes[f"names {name!r}"] = with_field("files", {**files, name: digest})
    for value in ("", digest[:-1], digest + "0", "Z" * 64, 0, None, ["0"] * 64):
        changes[f"a digest is {value!r:.20}"] = with_field("files", {**files, WEIGHTS: value})
    for members in ([], ["member-9.safetensors"], ["../member-0.safetensors"], [WEIGHTS, WEIGHTS], [0], [[WEIGHTS]]):
        changes[f"members are {members}"] = with_field("members", members)
    for count in (0, 2, -1, 10**30):
        changes[f"n_members is {count}"] = with_field("n_members", count)
    for version in (0, FORMAT_VERSION + 1, 99, -1, 3.0):
        changes[f"format_version is {version!r}"] = with_field("format_version", version)
    for key, values in MANIFEST_VALUES.items():
        changes |= {f"{key} is {value!r:.40}": with_field(key, value) for value in values}
    return changes


def _calibrations(frozen: pathlib.Path) -> dict[str, Change]:
    fields = dict(field_changes(json.loads((frozen / CALIBRATION).read_text()), CALIBRATED))
    for name in ("without temperature", "smallest_supported_delta is None"):  # both are valid
        del fields[name]
    values = {f"{field} is {value!r}": with_field(field, value) for field, value in CALIBRATION_VALUES}
    return {**document_changes(), **fields, **values}


def _golden_images() -> dict[str, Change]:
    p_occupied = np.full((48, 64), 0.99, np.float32)
    return {
        "an image of floats": with_array("rgb", np.zeros((48, 64, 3))),
        "an image without channels": with_array("rgb", np.zeros((48, 64), np.uint8)),
        "an image without pixels": with_array("rgb", np.zeros((0, 64, 3), np.uint8)),
        "a prediction of another size": with_array("p_occupied", p_occupied[:1]),
        "a prediction of integers": with_array("p_occupied", np.zeros((48, 64), np.int64)),
        "another prediction": with_array("p_occupied", p_occupied),
        "a prediction of NaN": with_array("p_occupied", np.full((48, 64), np.nan, np.float32)),
    }


def _programs() -> dict[str, Change]:
    def identity(path: pathlib.Path, random: Random) -> None:
        from onnx import TensorProto, helper

        value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1]) for name in ("x", "y")]
        graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "other", value[:1], value[1:])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
        rewrite(path, model.SerializeToString())

    return {
        "empty": filled(b""),
        "text": filled(b"a program"),
        "truncated": truncated,
        "zeros": filled(bytes(4096)),
        "another program": identity,
    }


def _folders(names: list[str]) -> dict[str, Corruption]:
    def exchange(given: pathlib.Path) -> None:
        (given / GOLDEN).rename(given / "exchanged")
        (given / CALIBRATION).rename(given / GOLDEN)
        (given / "exchanged").rename(given / CALIBRATION)

    def renamed(name: str) -> Corruption:
        return _renamed_folder(lambda given, random: "manifest", name)

    extra = ("member-1.safetensors", "run.py", "weights.pkl", "conda.yaml")
    return {
        **{f"an extra file, {name}": with_text(name) for name in extra},
        **{f"{name} is a link out of the folder": linked_outside(name) for name in names},
        "two files exchanged": edited(CALIBRATION, exchange),
        "an extra folder": edited("more", lambda given: (given / "more").mkdir()),
        "named like another ensemble": renamed(f"ensemble-{'0' * 16}"),
        "named ensemble-": renamed("ensemble-"),
    }
