"""Copies and images without a hand are shown with the training images of a run."""

import shutil

import cv2
import numpy as np
import pytest

from assets.interfaces import Store
from assets.perception import HandsConfig, raw_hands
from pipelines.home import DATASETS
from tests.ensembles import write_hands


@pytest.fixture
def folder(tmp_path):
    folder = write_hands(tmp_path / "hands")
    for part in ("images", "masks"):
        shutil.copyfile(folder / part / "1.png", folder / part / "again.png")
    cv2.imwrite(str(folder / "masks" / "3.png"), np.zeros((48, 64), np.uint8))
    return folder


@pytest.mark.filterwarnings("ignore:Parameter `data_version`")
def test_copies_and_images_without_a_hand_are_shown_with_the_training_images(folder, tmp_path):
    output = raw_hands(HandsConfig(folder=str(folder)), Store(tmp_path / "home", DATASETS))
    assert output.metadata["copies"].value == "again.png of 1.png"
    assert output.metadata["images without a hand"].value == 1
