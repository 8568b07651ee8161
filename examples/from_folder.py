"""The ensemble from its folder, with deltasafe and torch.

python from_folder.py ENSEMBLE IMAGE [-o p_occupied.npy]
"""

import argparse
import sys

import numpy as np

from deltasafe.errors import DeltasafeError
from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble
from deltasafe.perception.data.labeled_images import read_rgb


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ensemble", help="folder ensemble-..., as it was frozen")
    parser.add_argument("image", help="PNG or JPEG of any size")
    parser.add_argument("-o", "--output", default="p_occupied.npy", help="(H, W) float32 (default: %(default)s)")
    options = parser.parse_args()

    # every file is compared with its SHA-256 first; without `backend`, the fastest one is taken
    ensemble = load_ensemble(options.ensemble, backend="torch")
    difference = golden_difference(ensemble)
    p_occupied = ensemble.p_occupied(read_rgb(options.image))

    np.save(options.output, p_occupied)
    print(f"{ensemble.folder.name}: intact, golden image answered within {difference:.0e}")
    print(f"M = {len(ensemble)}, smallest supported delta: {ensemble.calibration.smallest_supported_delta}")
    print(f"p_occupied > 0.05 on {(p_occupied > 0.05).mean():.1%} of {options.image}")


if __name__ == "__main__":
    try:
        main()
    except DeltasafeError as error:  # a file is missing or altered, an image is none: the message says which
        sys.exit(f"from_folder: {error}")
