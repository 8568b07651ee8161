"""The overlays color exactly the misclassified pixels."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration import overlay_figure as overlays
from deltasafe.perception.calibration.overlay_figure import Overlay, overlay_figure

LABEL = np.zeros((12, 16), bool)
LABEL[3:9, 4:12] = True
IMAGE = np.full((12, 16, 3), 120, np.uint8)


def test_misclassified_pixels_have_the_color_of_their_error():
    p_occupied = np.where(LABEL, 0.9, 0.1)
    p_occupied[3, 4] = 0.3  # missed
    p_occupied[4, 4] = 0.05  # missed, and free at delta = 0.05
    p_occupied[0, 0] = 0.5  # false alarm: an exact 0.5 is predicted occupied
    figure = overlay_figure([Overlay("a", IMAGE, LABEL, p_occupied)], delta=0.05)
    image, heat, errors = (axes.get_images()[0].get_array() for axes in figure.axes[:3])
    np.testing.assert_array_equal(image, IMAGE)
    np.testing.assert_array_equal(heat, p_occupied)
    colors = {
        (3, 4): overlays._MISS,
        (4, 4): overlays._CONFIDENT_MISS,
        (0, 0): overlays._FALSE_ALARM,
    }
    for pixel, color in colors.items():
        np.testing.assert_allclose(errors[pixel], to_rgb(color))
    gray = np.ptp(errors, axis=2) == 0
    assert (~gray).sum() == 3
    assert "missed 4.2% of the hand, false alarms 0.7%" in [a.get_title(loc="left") for a in figure.axes]


def test_images_of_any_size_and_without_a_hand_can_be_drawn(tmp_path):
    empty = np.zeros((20, 9), bool)
    rows = [
        Overlay("a", IMAGE, LABEL, np.where(LABEL, 0.9, 0.1)),
        Overlay("no hand", np.zeros((20, 9, 3), np.uint8), empty, np.full((20, 9), 0.2)),
        Overlay("all hand", np.zeros((20, 9, 3), np.uint8), ~empty, np.full((20, 9), 0.2)),
    ]
    figure = overlay_figure(rows)
    figure.savefig(tmp_path / "rows.jpg", dpi=40)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert "no hand, false alarms 0.0%" in titles
    assert "missed 100.0% of the hand" in titles


def test_missing_images_and_images_of_other_size_are_refused():
    with pytest.raises(SettingsError, match="at least one image"):
        overlay_figure([])
    with pytest.raises(SettingsError, match="image of a must be uint8"):
        overlay_figure([Overlay("a", IMAGE[:, :5], LABEL, np.where(LABEL, 0.9, 0.1))])
