"""Predict with a frozen ensemble from its folder, with deltasafe and torch.

python from_folder.py ENSEMBLE IMAGE [-o p_occupied.npy]
"""

import argparse
import sys

import numpy as np

from deltasafe import DeltasafeError, load_ensemble, perception


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ensemble", help="folder ensemble-... of the frozen ensemble")
    parser.add_argument("image", help="PNG or JPEG of any size")
    parser.add_argument("-o", "--output", default="p_occupied.npy", help="(H, W) float32 (default: %(default)s)")
    options = parser.parse_args()

    # verifies the SHA-256 of every file; without `backend` it selects the fastest installed one
    ensemble = load_ensemble(options.ensemble, backend="torch")
    difference = perception.golden_difference(ensemble)
    p_occupied = ensemble.p_occupied(perception.read_rgb(options.image))

    np.save(options.output, p_occupied)
    print(f"{ensemble.folder.name}: intact, golden image reproduced within {difference:.0e}")
    print(f"M = {len(ensemble)}, smallest supported delta: {ensemble.calibration.smallest_supported_delta}")
    print(f"p_occupied > 0.05 on {(p_occupied > 0.05).mean():.1%} of {options.image}")


if __name__ == "__main__":
    try:
        main()
    except DeltasafeError as error:  # the message names the file and the remedy
        sys.exit(f"from_folder: {error}")
