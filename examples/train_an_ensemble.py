"""Train, evaluate and freeze an ensemble from labeled images, without Dagster.

python train_an_ensemble.py TRAIN TEST OUT     # folders with images/ and masks/; about half an hour on two cores
"""

import pathlib
import sys

from deltasafe import DeltasafeError, perception


def main(train_folder: str, test_folder: str, out: str, quick: bool = False) -> pathlib.Path:
    """Write a frozen ensemble to a folder of ``out``; ``quick`` only tests that every step runs."""
    folder = pathlib.Path(out)
    train = perception.LabeledImageSet.load(train_folder)
    test = perception.LabeledImageSet.load(test_folder)
    perception.check_disjoint(train, test)

    augmentation = perception.AugmentationSettings(**({"n_variants": 1, "width": 96, "height": 72} if quick else {}))
    augmented = perception.augment_images(train, folder / "augmented", augmentation)
    training = perception.TrainingSettings(epochs=1 if quick else 5)
    members = perception.train_ensemble(augmented, folder / "members", training, n_members=2 if quick else 5)

    report = perception.evaluate_ensemble(members, test, folder / "report")
    print(f"mIoU {report.figures()['miou']:.3f}; pictures and figures in {folder / 'report' / 'report.md'}")
    for failure in perception.gate(report, perception.GateThresholds()):
        print(f"the gate refuses this ensemble: {failure}")
    golden_image, _ = train.read(0)
    frozen = perception.freeze_ensemble(members, folder / "report", golden_image, folder)
    p_occupied = perception.load_ensemble(frozen).p_occupied(golden_image)
    print(f"{frozen}: p_occupied up to {p_occupied.max():.2f} in {train.items[0].id}")
    return frozen


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    try:
        main(*sys.argv[1:])
    except DeltasafeError as error:
        sys.exit(f"train_an_ensemble: {error}")
