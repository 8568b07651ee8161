"""Frozen ensembles: exchanged files, a manifest that lies, content that is damaged although its digest fits."""

import hashlib
import json
import os
import pathlib
from collections.abc import Callable
from random import Random
from typing import Any

from deltasafe.perception.artifact import golden_difference, load_ensemble
from evidence.faults.judging import Case, Door, Spoil, rewrite
from evidence.faults.malformed.documents import changed, document_spoils, field_spoils
from evidence.faults.malformed.files import at, file_spoils, filled, linked_out
from evidence.faults.malformed.packed import array_spoils, with_array
from evidence.faults.malformed.weights import weight_spoils

__all__ = ["ensemble_cases", "resealed"]

Change = Callable[[pathlib.Path, Random], None]
MANIFEST, CALIBRATION, GOLDEN, PROGRAM = "manifest.json", "calibration.json", "golden.npz", "ensemble.onnx"
WEIGHTS = "member-0.safetensors"
STATED = ("format_version", "files", "members", "n_members", "network", "inference")
CALIBRATED = [
    "n_images",
    "n_members",
    "pixel_accuracy",
    "miou",
    "brier",
    "nll",
    "expected_calibration_error",
    "smallest_supported_delta",
    "temperature",
]
"""Required, or of a kind that matters."""


def ensemble_cases(frozen: pathlib.Path) -> list[Case]:
    """A frozen ensemble for `load_ensemble` and ``deltasafe verify``."""

    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        golden_difference(load_ensemble(given))

    door = Door("ensemble", frozen, read, lambda given, out: ["verify", str(given)])
    names = sorted(path.name for path in frozen.iterdir())
    spoils: dict[str, Spoil] = {}
    for name in names:
        for spoil, change in file_spoils().items():
            spoils[f"{name}: {spoil}"] = at(name, change)
    spoils |= {f"{MANIFEST}: {name}": _in_open(at(MANIFEST, change)) for name, change in _lies(frozen).items()}
    for name, change in document_spoils().items():
        spoils[f"{CALIBRATION}, its digest right: {name}"] = resealed(CALIBRATION, change)
    calibration = json.loads((frozen / CALIBRATION).read_text())
    for name, change in field_spoils(calibration, CALIBRATED):
        if name not in ("without temperature", "smallest_supported_delta is None"):
            spoils[f"{CALIBRATION}, its digest right: {name}"] = resealed(CALIBRATION, change)
    for field, value in _impossible():
        spoils[f"{CALIBRATION}, its digest right: {field} is {value!r}"] = resealed(CALIBRATION, changed(field, value))
    for name, change in weight_spoils().items():
        spoils[f"{WEIGHTS}, its digest right: {name}"] = resealed(WEIGHTS, change)
    for name, change in {**array_spoils(frozen / GOLDEN), **_golden()}.items():
        spoils[f"{GOLDEN}, its digest right: {name}"] = resealed(GOLDEN, change)
    for name, change in _programs().items():
        spoils[f"{PROGRAM}, its digest right: {name}"] = resealed(PROGRAM, change)
    return [Case(name, door, spoil) for name, spoil in {**spoils, **_folders(names)}.items()]


def resealed(name: str, change: Change) -> Spoil:
    """Change a file, and the manifest with it; the folder goes by a name that says nothing."""

    def spoil(given: pathlib.Path, random: Random) -> str:
        change(given / name, random)
        if (given / name).is_file() and os.access(given / name, os.R_OK):
            manifest = json.loads((given / MANIFEST).read_text())
            manifest["files"][name] = hashlib.sha256((given / name).read_bytes()).hexdigest()
            rewrite(given / MANIFEST, json.dumps(manifest).encode())
        return _renamed(given, name)

    return spoil


def _in_open(spoil: Spoil) -> Spoil:
    return lambda given, random: _renamed(given, spoil(given, random) or "")


def _renamed(given: pathlib.Path, culprit: str) -> str:
    """A link of the given name leads to the folder under a name that is no digest."""
    there = given.rename(given.with_name("pulled"))
    given.symlink_to(there.name)
    return culprit


def _lies(frozen: pathlib.Path) -> dict[str, Change]:
    manifest = json.loads((frozen / MANIFEST).read_text())
    lies = {**document_spoils(), **dict(field_spoils(manifest, STATED))}
    digest = "0" * 64
    for name in ("../secret", "/etc/passwd", "..", ".", "", "a/b", "a\0b", "a\nb", MANIFEST, "./golden.npz"):
        lies[f"names {name!r}"] = changed("files", {**manifest["files"], name: digest})
    for value in ("", digest[:-1], digest + "0", "Z" * 64, 0, None, ["0"] * 64):
        lies[f"a digest is {value!r:.20}"] = changed("files", {**manifest["files"], WEIGHTS: value})
    for members in ([], ["member-9.safetensors"], ["../member-0.safetensors"], [WEIGHTS, WEIGHTS], [0], [[WEIGHTS]]):
        lies[f"members are {members}"] = changed("members", members)
    for count in (0, 2, -1, 10**30):
        lies[f"n_members is {count}"] = changed("n_members", count)
    for version in (0, 4, 99, -1, 3.0):
        lies[f"format_version is {version!r}"] = changed("format_version", version)
    for key, values in _networks().items():
        for value in values:
            lies[f"{key} is {value!r:.40}"] = changed(key, value)
    return lies


def _networks() -> dict[str, list[Any]]:
    return {
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


def _impossible() -> list[tuple[str, Any]]:
    return [
        ("n_images", 0),
        ("n_images", -5),
        ("n_members", 2),
        ("n_members", 0),
        ("pixel_accuracy", 1.5),
        ("miou", -0.1),
        ("brier", 2.0),
        ("expected_calibration_error", 7.0),
        ("level", 95.0),
        ("smallest_supported_delta", 0.0),
        ("smallest_supported_delta", 1.0),
        ("smallest_supported_delta", -0.05),
        ("temperature", 0.0),
        ("temperature", -1.0),
        ("surplus", 1.0),
    ]


def _golden() -> dict[str, Change]:
    import numpy as np

    return {
        "an image of floats": with_array("rgb", np.zeros((48, 64, 3))),
        "an image without colours": with_array("rgb", np.zeros((48, 64), np.uint8)),
        "an image without pixels": with_array("rgb", np.zeros((0, 64, 3), np.uint8)),
        "an answer of another size": with_array("p_occupied", np.zeros((1, 64), np.float32)),
        "an answer of whole numbers": with_array("p_occupied", np.zeros((48, 64), np.int64)),
        "another answer": with_array("p_occupied", np.full((48, 64), 0.99, np.float32)),
        "an answer that is NaN": with_array("p_occupied", np.full((48, 64), np.nan, np.float32)),
    }


def _programs() -> dict[str, Change]:
    def other(path: pathlib.Path, random: Random) -> None:
        from onnx import TensorProto, helper

        value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1]) for name in ("x", "y")]
        graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "other", value[:1], value[1:])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
        rewrite(path, model.SerializeToString())

    return {
        "empty": filled(b""),
        "text": filled(b"a program"),
        "cut in half": lambda path, _: rewrite(path, path.read_bytes()[: path.stat().st_size // 2]),
        "zeros": filled(bytes(4096)),
        "a program of something else": other,
    }


def _folders(names: list[str]) -> dict[str, Spoil]:
    def added(name: str) -> Spoil:
        def spoil(given: pathlib.Path, random: Random) -> str:
            (given / name).write_text("x")
            return name

        return spoil

    def exchanged(given: pathlib.Path, random: Random) -> str:
        (given / GOLDEN).rename(given / "kept")
        (given / CALIBRATION).rename(given / GOLDEN)
        (given / "kept").rename(given / CALIBRATION)
        return CALIBRATION

    def a_folder_more(given: pathlib.Path, random: Random) -> str:
        (given / "more").mkdir()
        return "more"

    def named(name: str) -> Spoil:
        def spoil(given: pathlib.Path, random: Random) -> str:
            there = given.rename(given.with_name(name))
            given.symlink_to(there.name)
            return "manifest"

        return spoil

    return {
        **{
            f"a file more, {name}": added(name)
            for name in ("member-1.safetensors", "run.py", "weights.pkl", "conda.yaml")
        },
        **{f"{name} is a link out of the folder": linked_out(name) for name in names},
        "two files exchanged": exchanged,
        "a folder more": a_folder_more,
        "named as another one": named(f"ensemble-{'0' * 16}"),
        "named ensemble-": named("ensemble-"),
    }
