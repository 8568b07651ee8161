"""Actions in the Dagster UI, as functions of an open page."""

import re

CHAIN = {
    "perception": [
        "raw_hands",
        "test_hands",
        "augmented_hands",
        "ensemble_member",
        "calibration_report",
        "frozen_ensemble",
        "champion",
    ],
    "motion": ["logged_scenes", "occupancy_fields", "planned_motions", "executed_motions", "safety_report"],
}
"""Assets of the chain, by group."""
MARGIN_PX = 12


def link(page, text):
    """Find a link by its text. The UI may render the text twice, and the accessible name includes that of an icon."""
    return page.get_by_role("link").filter(has_text=re.compile(rf"^({re.escape(text)}\s*)+$")).first


def button(page, icon):
    """Find a button by the name of its icon."""
    return page.get_by_role("button", name=icon)


def dialog_of(page):
    """Return the dialog over the page."""
    return page.locator(".dagster-dialog")


def close_dialog(page):
    page.keyboard.press("Escape")
    dialog_of(page).wait_for(state="detached")


def navigate(page, name):
    """Click an entry of the navigation on the left."""
    link(page, name).click()


def search(page, query):
    """Enter a query in the search box above a catalog or a graph."""
    page.locator(".CodeMirror").first.click()
    page.keyboard.press("Control+A")
    page.keyboard.insert_text(query)
    page.keyboard.press("Enter")


def open_asset(page, name, tab="Overview"):
    navigate(page, "Catalog")
    search(page, f'key:"{name}"')
    link(page, name).click()
    page.get_by_role("tab", name=tab).click()


def open_markdown(page, key):
    """Open the Markdown that the page of an asset shows under ``key``; return the dialog."""
    row = page.get_by_role("row").filter(has=page.get_by_text(key, exact=True))
    row.get_by_text("[Show Markdown]").click()
    dialog_of(page).wait_for()
    return dialog_of(page)


def sizes_of_pictures(shown):
    """Return width and height in pixels of every picture as the browser decodes it; 0 if decoding fails."""
    return shown.locator("img").evaluate_all(
        "images => Promise.all(images.map(async image => {"
        " await image.decode().catch(() => 0); return [image.naturalWidth, image.naturalHeight] }))"
    )


def open_graph_of_the_chain(page):
    """Open the graph of the chain with expanded groups and without panels; return its rectangle."""
    navigate(page, "Lineage")
    button(page, "Hide navigation").click()
    search(page, " or ".join(f'group:"{group}"' for group in CHAIN))
    page.get_by_text("tracking_study").first.wait_for(state="detached")
    button(page, "panel_show_right").click()
    page.mouse.click(600, page.viewport_size["height"] - 40, button="right")
    page.get_by_role("menuitem", name="Expand all groups").click()
    for name in (name for names in CHAIN.values() for name in names):
        page.locator("foreignObject").get_by_text(name, exact=True).first.wait_for()
    page.wait_for_timeout(2000)  # the animation ends
    button(page, "zoom_out").click()  # so that no node is below a button
    page.wait_for_timeout(5000)  # the states of the assets load last
    boxes = [node.bounding_box() for node in page.locator("foreignObject").all()]
    left, top = (min(box[side] for box in boxes) - MARGIN_PX for side in ("x", "y"))
    right = max(box["x"] + box["width"] for box in boxes) + MARGIN_PX
    bottom = max(box["y"] + box["height"] for box in boxes) + MARGIN_PX
    return {"x": left, "y": top, "width": right - left, "height": bottom - top}


def show_navigation(page):
    button(page, "panel_show_left").first.click()


def open_launchpad(page):
    """Open the launchpad of the asset or job whose page is open; return the dialog."""
    button(page, "Materialize").first.locator("xpath=following::button[1]").click()
    page.get_by_role("menuitem", name="Open launchpad").click()
    dialog_of(page).locator(".CodeMirror").first.wait_for()
    return dialog_of(page)


def configure(page, yaml):
    """Replace the configuration in the open launchpad."""
    dialog_of(page).locator(".CodeMirror").first.click()
    page.keyboard.press("Control+A")
    page.keyboard.insert_text(yaml)


def end_of_run(page):
    """Wait without a time limit until a run on the open page has ended; return its status."""
    end = page.get_by_text(re.compile(r"^(Success|Failure|Canceled)$")).first
    end.wait_for(timeout=0)
    return end.inner_text()
