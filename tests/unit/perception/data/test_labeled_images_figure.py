"""The sheet of labeled images: its size, and the outlines of the masks."""

import cv2
import numpy as np

from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.labeled_images_figure import labeled_images_figure
from tests.ensembles import write_hands


def decoded(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def test_sheet_has_no_more_tiles_than_images(tmp_path):
    images = LabeledImageSet.load(write_hands(tmp_path / "hands", n=3))
    sheet = decoded(labeled_images_figure(images, n_images=12, columns=4, width=64))
    assert sheet.shape == (48, 3 * 64, 3)
    assert decoded(labeled_images_figure(images, n_images=2, columns=1, width=64)).shape == (2 * 48, 64, 3)


def test_outline_of_the_mask_is_drawn(tmp_path):
    folder = write_hands(tmp_path / "hands", n=1)
    gray = np.full((480, 640, 3), 90, np.uint8)
    mask = np.zeros((480, 640), np.uint8)
    mask[120:360, 160:480] = 255
    cv2.imwrite(str(folder / "images" / "0.png"), gray)
    cv2.imwrite(str(folder / "masks" / "0.png"), mask)
    sheet = decoded(labeled_images_figure(LabeledImageSet.load(folder), width=640)).astype(int)
    blue = sheet[..., 2] - sheet[..., 0] > 60
    rows, columns = np.nonzero(blue)
    assert abs(rows.min() - 120) <= 2
    assert abs(rows.max() - 359) <= 2
    assert abs(columns.min() - 160) <= 2
    assert not blue[200:300, 220:420].any(), "the inside is not filled"
