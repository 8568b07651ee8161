"""What a person does in the Dagster UI, as functions of an open page."""

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
"""Groups of the chain, and their assets."""
MARGIN_PX = 12


def link(page, text):
    """By what is written on it, once or (to be measured) twice; its accessible name has that of an icon in it."""
    return page.get_by_role("link").filter(has_text=re.compile(rf"^({re.escape(text)}\s*)+$")).first


def button(page, icon):
    """By the name of its icon."""
    return page.get_by_role("button", name=icon)


def dialog_of(page):
    """The window over the page."""
    return page.locator(".dagster-dialog")


def close_dialog(page):
    page.keyboard.press("Escape")
    dialog_of(page).wait_for(state="detached")


def navigate(page, name):
    """By the navigation at the left edge."""
    link(page, name).click()


def search(page, query):
    """In the box over a catalog or a graph."""
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
    """Open what an asset's page shows under ``key``; the window that it is shown in."""
    row = page.get_by_role("row").filter(has=page.get_by_text(key, exact=True))
    row.get_by_text("[Show Markdown]").click()
    dialog_of(page).wait_for()
    return dialog_of(page)


def sizes_of_pictures(shown):
    """Width and height in pixels of every picture, as decoded by the browser; 0 if it cannot be decoded."""
    return shown.locator("img").evaluate_all(
        "images => Promise.all(images.map(async image => {"
        " await image.decode().catch(() => 0); return [image.naturalWidth, image.naturalHeight] }))"
    )


def open_graph_of_the_chain(page):
    """The graph of the chain alone, with the groups opened and everything else out of the way; its rectangle."""
    navigate(page, "Lineage")
    button(page, "Hide navigation").click()
    search(page, " or ".join(f'group:"{group}"' for group in CHAIN))
    page.get_by_text("tracking_study").first.wait_for(state="detached")
    button(page, "panel_show_right").click()
    page.mouse.click(600, page.viewport_size["height"] - 40, button="right")
    page.get_by_role("menuitem", name="Expand all groups").click()
    for name in (name for names in CHAIN.values() for name in names):
        page.locator("foreignObject").get_by_text(name, exact=True).first.wait_for()
    page.wait_for_timeout(2000)  # it glides to where it fits
    button(page, "zoom_out").click()  # away from the buttons at the edge
    page.wait_for_timeout(5000)  # the states of the assets come last
    boxes = [node.bounding_box() for node in page.locator("foreignObject").all()]
    left, top = (min(box[side] for box in boxes) - MARGIN_PX for side in ("x", "y"))
    right = max(box["x"] + box["width"] for box in boxes) + MARGIN_PX
    bottom = max(box["y"] + box["height"] for box in boxes) + MARGIN_PX
    return {"x": left, "y": top, "width": right - left, "height": bottom - top}


def show_navigation(page):
    button(page, "panel_show_left").first.click()


def open_launchpad(page):
    """Of the asset or job whose page is open."""
    button(page, "Materialize").first.locator("xpath=following::button[1]").click()
    page.get_by_role("menuitem", name="Open launchpad").click()
    dialog_of(page).locator(".CodeMirror").first.wait_for()
    return dialog_of(page)


def configure(page, yaml):
    """Write over what the open launchpad holds."""
    dialog_of(page).locator(".CodeMirror").first.click()
    page.keyboard.press("Control+A")
    page.keyboard.insert_text(yaml)


def end_of_run(page):
    """Watch the open page of a run, or the list of all, until one has ended, however long that takes."""
    end = page.get_by_text(re.compile(r"^(Success|Failure|Canceled)$")).first
    end.wait_for(timeout=0)
    return end.inner_text()
