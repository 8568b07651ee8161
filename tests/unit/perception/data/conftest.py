"""Three of the packaged training images as a set of their own."""

import pathlib
import shutil

import pytest

from deltasafe.perception.data.labeled_images import LabeledImageSet

DATASETS = pathlib.Path(__file__).parents[4] / "datasets"


@pytest.fixture(scope="session")
def three_images(tmp_path_factory: pytest.TempPathFactory) -> LabeledImageSet:
    folder = tmp_path_factory.mktemp("labeled") / "three"
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
        for source in sorted((DATASETS / "hands" / "train" / kind).iterdir())[:3]:
            shutil.copy(source, folder / kind)
    return LabeledImageSet.load(folder)
