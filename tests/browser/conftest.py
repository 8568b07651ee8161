"""A browser with the Dagster UI that `make ui` starts, on a new home with the smoke preset."""

import os
import pathlib

import pytest

from tests.browser.service import CHROMIUM_VARIABLE, PATIENT_MS, find_chromium
from tests.loopback import serve

SCREENSHOTS_VARIABLE = "DELTASAFE_SCREENSHOTS"


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed; run `make browser-test`")
    with api.sync_playwright() as playwright:
        found = find_chromium(playwright)
        if found is None:
            pytest.skip(f"Chromium is missing: install it, or set ${CHROMIUM_VARIABLE} to its path")
        opened = playwright.chromium.launch(executable_path=found)
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def ui(browser, tmp_path_factory):
    """Return the address of the Dagster UI."""
    folder = tmp_path_factory.mktemp("ui")
    with serve(folder / "home", "smoke", folder / "ui.log") as (address, _):
        yield address


@pytest.fixture(scope="session")
def tab(browser, ui):
    """Open one tab, which all tests share."""
    context = browser.new_context(viewport={"width": 1500, "height": 1000}, base_url=ui, reduced_motion="reduce")
    context.set_default_timeout(PATIENT_MS)
    yield context.new_page()
    context.close()


@pytest.fixture
def page(tab):
    """Open the first page of the UI in the tab."""
    tab.goto("/")
    return tab


@pytest.fixture(scope="session")
def screenshot(tab, tmp_path_factory):
    """Return a function that stores a screenshot of the page, or of a rectangle of it."""
    chosen = os.environ.get(SCREENSHOTS_VARIABLE)
    folder = pathlib.Path(chosen).resolve() if chosen else tmp_path_factory.mktemp("screenshots")
    folder.mkdir(parents=True, exist_ok=True)

    def take(name, clip=None):
        tab.screenshot(path=folder / f"{name}.png", animations="disabled", clip=clip)

    return take
