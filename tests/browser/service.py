"""The browser that looks at the UI."""

import os
import pathlib
import shutil

CHROMIUM_VARIABLE = "DELTASAFE_CHROMIUM"
INSTALLED = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENT_MS = 180_000
"""For what a page shows by itself; the end of a run is waited for as long as it takes."""


def find_chromium(playwright):
    """The program that is named or installed, or else Playwright's own; None if there is none."""
    named = os.environ.get(CHROMIUM_VARIABLE) or next(filter(None, map(shutil.which, INSTALLED)), None)
    found = named or playwright.chromium.executable_path
    return found if pathlib.Path(found).is_file() else None
