"""A browser before the Dagster UI as `make ui` starts it, on a fresh home with the smoke preset."""

import os
import pathlib

import pytest

from tests.browser.service import CHROMIUM_VARIABLE, PATIENT_MS, find_chromium
from tests.loopback import serve

SCREENSHOTS_VARIABLE = "DELTASAFE_SCREENSHOTS"


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: `make browser-test` does")
    with api.sync_playwright() as playwright:
        found = find_chromium(playwright)
        if found is None:
            pytest.skip(f"there is no Chromium: install one, or name it in ${CHROMIUM_VARIABLE}")
        opened = playwright.chromium.launch(executable_path=found)
        yield opened
        opened.close()


@pytest.fixture(scope="session")
def ui(browser, tmp_path_factory):
    """Address of the Dagster UI."""
    folder = tmp_path_factory.mktemp("ui")
    with serve(folder / "home", "smoke", folder / "ui.log") as (address, _):
        yield address


@pytest.fixture(scope="session")
def tab(browser, ui):
    """One tab, as a person has one."""
    context = browser.new_context(viewport={"width": 1500, "height": 1000}, base_url=ui, reduced_motion="reduce")
    context.set_default_timeout(PATIENT_MS)
    yield context.new_page()
    context.close()


@pytest.fixture
def page(tab):
    """The tab at the first page of the UI."""
    tab.goto("/")
    return tab


@pytest.fixture(scope="session")
def screenshot(tab, tmp_path_factory):
    """Keeps a picture of the page, or of a rectangle of it, for whoever looks."""
    chosen = os.environ.get(SCREENSHOTS_VARIABLE)
    folder = pathlib.Path(chosen).resolve() if chosen else tmp_path_factory.mktemp("screenshots")
    folder.mkdir(parents=True, exist_ok=True)

    def take(name, clip=None):
        tab.screenshot(path=folder / f"{name}.png", animations="disabled", clip=clip)

    return take
