"""The browser of the tests."""

import os
import pathlib
import shutil

CHROMIUM_VARIABLE = "DELTASAFE_CHROMIUM"
INSTALLED = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENT_MS = 180_000
"""Timeout for content of a page. The end of a run has no timeout."""


def find_chromium(playwright):
    """Return the path of Chromium: from the variable, installed, or that of Playwright; None if there is none."""
    named = os.environ.get(CHROMIUM_VARIABLE) or next(filter(None, map(shutil.which, INSTALLED)), None)
    found = named or playwright.chromium.executable_path
    return found if pathlib.Path(found).is_file() else None
