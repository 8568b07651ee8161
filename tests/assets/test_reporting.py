"""Metadata of assets: summaries, figures, digests and pictures."""

import numpy as np
from PIL import Image

from assets.reporting import folder_facts, inline_picture, readable, summary_of

REPORT = """# Calibration report

It was judged on **50 images**.

It supports a delta of 0.02.

## At a glance

| a | b |
"""


def test_the_summary_is_the_text_before_the_first_section():
    assert summary_of(REPORT)["summary"].value == "It was judged on **50 images**.\n\nIt supports a delta of 0.02."


def test_a_long_summary_is_cut_at_a_paragraph_and_wrapped():
    shown = summary_of("# A\n\n" + "\n\n".join(200 * f"{letter} " for letter in "abc"))["summary"].value
    assert shown.replace("  \n", " ") == 199 * "a " + "a\n\n" + 199 * "b " + "b"
    assert max(map(len, shown.split("\n"))) <= 62, "no line is wider than the column"
    assert summary_of("# A\n\n" + 1000 * "a ") == {}


def test_the_summary_skips_tables_and_pictures():
    shown = summary_of("# A\n\nYes.\n\n| a |\n|---|\n| 1 |\n\n![plot](plot.png)\n\nNo.")["summary"].value
    assert shown == "Yes.\n\nNo."


def test_figures_get_names_units_and_four_digits():
    figures = {
        "pa": 0.98710412,
        "n_members": 5,
        "max_tracking_error_m": 0.000726123,
        "duration_s": 12.3456,
        "v_max_mps": 0.2,
        "contacts": 12345678,
        "smallest_supported_delta": 0.02,
    }
    assert readable(figures) == {
        "pixel accuracy": 0.9871,
        "members": 5,
        "max tracking error [mm]": 0.7261,
        "duration [s]": 12.35,
        "v max [mm/s]": 200.0,
        "contacts": 12345678,
        "smallest supported delta": 0.02,
    }


def test_the_digest_covers_names_and_contents(tmp_path):
    def digest_of(name, files):
        folder = tmp_path / name
        for path, text in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text)
        return folder_facts(folder)["digest"]

    files = {"a.txt": "1", "sub/b.txt": "2"}
    assert digest_of("one", files) == digest_of("two", files)
    assert digest_of("three", files | {"a.txt": "2"}) != digest_of("one", files)
    assert digest_of("four", {"b.txt": "1", "sub/b.txt": "2"}) != digest_of("one", files)
    assert folder_facts(tmp_path / "one", "known")["digest"] == "known"


def test_plots_become_png_and_photographs_jpeg(tmp_path):
    x, y = np.meshgrid(np.arange(1200), np.arange(900))
    smooth = np.stack([127 + 120 * np.sin(x / 90), 127 + 120 * np.cos(y / 70), 127 + 120 * np.sin((x + y) / 110)], -1)
    noisy = np.clip(smooth + np.random.default_rng(0).normal(0, 25, smooth.shape), 0, 255)
    plot = np.full((900, 1200, 3), 255)
    plot[::40], plot[:, ::50] = (0, 90, 160), (30, 30, 30)
    for name, pixels in (("photograph", noisy), ("plot", plot)):
        Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / f"{name}.png")
    assert "data:image/jpeg" in inline_picture(tmp_path / "photograph.png").value
    assert "data:image/png" in inline_picture(tmp_path / "plot.png", 4_000).value
