"""Predict with a frozen ensemble from its folder, with onnxruntime and numpy, without deltasafe.

python with_onnxruntime.py ENSEMBLE IMAGE [-o p_occupied.npy]
"""

import argparse
import hashlib
import json
import math
import pathlib
import sys
from typing import Any

import numpy as np
import onnxruntime
from PIL import Image, ImageOps


class ArtifactError(Exception):
    """The folder is not an intact ensemble. The message names the file."""


def verified(folder: pathlib.Path) -> dict[str, Any]:
    """Verify the SHA-256 of every file and the name of the folder; return the manifest."""
    if not (folder / "manifest.json").is_file():
        raise ArtifactError(f"{folder}: is not the folder of a frozen ensemble (manifest.json is missing)")
    content = (folder / "manifest.json").read_bytes()
    if folder.resolve().name != (name := f"ensemble-{hashlib.sha256(content).hexdigest()[:16]}"):
        raise ArtifactError(
            f"{folder / 'manifest.json'}: was altered, or the folder was renamed; rename it to {name} if that is all, "
            "otherwise download it again"
        )
    manifest: dict[str, Any] = json.loads(content)
    for name, digest in manifest["files"].items():
        if not (folder / name).is_file():
            raise ArtifactError(f"{folder / name}: is missing; download the ensemble again")
        if hashlib.sha256((folder / name).read_bytes()).hexdigest() != digest:
            raise ArtifactError(f"{folder / name}: was altered (its SHA-256 differs); download the ensemble again")
    return manifest


class HandEnsemble:
    """Predicts p_occupied with `ensemble.onnx`."""

    def __init__(self, folder: pathlib.Path) -> None:
        manifest = verified(folder)
        if manifest["format_version"] not in (3, 4):
            raise ArtifactError(f"{folder}: is of format {manifest['format_version']}; this script reads 3 and 4")
        self.inference = manifest["inference"]
        self.temperature = json.loads((folder / "calibration.json").read_text())["temperature"]
        self.program = onnxruntime.InferenceSession(folder / "ensemble.onnx", providers=["CPUExecutionProvider"])
        with np.load(folder / "golden.npz", allow_pickle=False) as golden:
            self.golden_difference = np.abs(self.p_occupied(golden["rgb"]) - golden["p_occupied"]).max()
        if not self.golden_difference <= 1e-4:
            raise ArtifactError(
                f"{folder}: p_occupied of the golden image is off by {self.golden_difference:.2g} on this machine"
            )

    def p_occupied(self, rgb: np.ndarray) -> np.ndarray:
        """Predict (H, W) float32 for uint8 (H, W, 3): mean over members and scales, then temperature."""
        scales = self.inference.get("scales", [1.0])  # format 3 has one scale
        mean = sum(self.mean_of_members(rgb, scale) for scale in scales) / len(scales)
        mean = np.clip(mean, 1e-7, 1 - 1e-7)
        return sigmoid(np.log(mean / (1 - mean)) / self.temperature).astype(np.float32)

    def mean_of_members(self, rgb: np.ndarray, scale: float) -> np.ndarray:
        """Predict the mean of the members (H, W) with the image at one scale of the inference size."""
        height, width = rgb.shape[:2]
        scale *= math.sqrt(self.inference["height"] * self.inference["width"] / (height * width))
        h, w = (max(2, round(side * scale / 16)) * 16 for side in (height, width))
        weights = area if h * w < height * width else bilinear
        small = np.einsum("yY,YXc,xX->yxc", weights(height, h), rgb.astype(float), weights(width, w), optimize=True)
        scaled = np.rint(small).astype(np.uint8)
        logits = self.program.run(["member_logits"], {"rgb": scaled[None]})[0][0]  # (M, h, w)
        full = bilinear(h, height) @ logits @ bilinear(w, width).T
        return np.asarray(sigmoid(full).mean(axis=0))


def read_rgb(path: pathlib.Path) -> np.ndarray:
    """Read an image as uint8 (H, W, 3), upright; refuse what cannot be converted without a decision."""
    with Image.open(path) as picture:
        upright = ImageOps.exif_transpose(picture)
    if upright.mode not in ("RGB", "L", "1", "P", "RGBA", "LA", "CMYK", "YCbCr"):  # convert() clips 16 bits to white
        raise ArtifactError(f"{path}: has the mode {upright.mode}; convert it to 8 bits per channel")
    rgba = upright.convert("RGBA")
    if rgba.getextrema()[3][0] < 255:
        raise ArtifactError(f"{path}: is partly transparent; save it without transparency")
    return np.asarray(upright.convert("RGB"))


def area(size: int, target: int) -> np.ndarray:
    """Weights (target, size) that average the pixels covered by each new pixel."""
    edge, pixel = np.arange(target + 1) * size / target, np.arange(size)
    covered = np.minimum(edge[1:, None], pixel + 1) - np.maximum(edge[:-1, None], pixel)
    return covered.clip(0) * target / size


def bilinear(size: int, target: int) -> np.ndarray:
    """Weights (target, size) that interpolate linearly between pixel centers."""
    center = ((np.arange(target) + 0.5) * size / target - 0.5).clip(0, size - 1)
    return (1 - np.abs(center[:, None] - np.arange(size))).clip(0)


def sigmoid(x: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-x))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ensemble", type=pathlib.Path, help="folder ensemble-... of the frozen ensemble")
    parser.add_argument("image", type=pathlib.Path, help="PNG or JPEG of any size")
    parser.add_argument("-o", "--output", default="p_occupied.npy", help="(H, W) float32 (default: %(default)s)")
    options = parser.parse_args()

    ensemble = HandEnsemble(options.ensemble)
    p_occupied = ensemble.p_occupied(read_rgb(options.image))

    np.save(options.output, p_occupied)
    print(f"{options.ensemble.name}: intact, golden image reproduced within {ensemble.golden_difference:.0e}")
    print(f"p_occupied > 0.05 on {(p_occupied > 0.05).mean():.1%} of {options.image}")


if __name__ == "__main__":
    try:
        main()
    except (ArtifactError, OSError) as error:
        sys.exit(f"with_onnxruntime: {error}")
