"""`make pictures`: screenshots of the UI for the README, from the present content of the home."""

import argparse
import os
import pathlib
import sys
import tempfile

from PIL import Image
from playwright.sync_api import sync_playwright

from deltasafe.presets import VARIABLE
from pipelines.home import home
from tests.browser.clicks import open_asset, open_graph_of_the_chain, open_markdown, show_navigation
from tests.browser.service import CHROMIUM_VARIABLE, PATIENT_MS, find_chromium
from tests.loopback import serve


def main():
    """Take the screenshots; return 0 if both were taken."""
    parser = argparse.ArgumentParser(prog="python -m tests.browser.pictures", description=__doc__)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("docs/pictures"), metavar="DIR")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    preset = os.environ.get(VARIABLE) or "default"
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        chromium = find_chromium(playwright)
        if chromium is None:
            print(f"Chromium is missing: install it, or set ${CHROMIUM_VARIABLE} to its path", file=sys.stderr)
            return 1
        with serve(home(), preset, pathlib.Path(folder, "ui.log")) as (address, _):
            browser = playwright.chromium.launch(executable_path=chromium)
            size = {"width": 1500, "height": 1000}
            context = browser.new_context(viewport=size, base_url=address, device_scale_factor=1.5)
            context.set_default_timeout(PATIENT_MS)
            page = context.new_page()
            page.goto("/")
            page.screenshot(path=out / "graph.png", clip=open_graph_of_the_chain(page), animations="disabled")
            show_navigation(page)
            open_asset(page, "calibration_report")
            open_markdown(page, "report").locator("img").first.scroll_into_view_if_needed()
            page.wait_for_timeout(1000)
            page.screenshot(path=out / "report.png", animations="disabled")
            browser.close()
    for name in ("graph", "report"):
        with Image.open(out / f"{name}.png") as opened:
            few_colors = opened.convert("RGB").quantize(255, dither=Image.Dither.NONE)
        few_colors.save(out / f"{name}.png", optimize=True)
        print(out / f"{name}.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
