"""The UI, used by clicks: run the whole chain, read reports, enter invalid settings, read the errors.

The tests build on each other: each continues with the home of the previous one.
"""

import re

import pytest

from tests.browser.clicks import (
    CHAIN,
    button,
    close_dialog,
    configure,
    dialog_of,
    end_of_run,
    link,
    navigate,
    open_asset,
    open_graph_of_the_chain,
    open_launchpad,
    open_markdown,
    search,
    show_navigation,
    sizes_of_pictures,
)

PICTURES = {
    "raw_hands": ["examples"],
    "test_hands": ["examples"],
    "augmented_hands": ["contact sheet"],
    "ensemble_member": ["loss"],
    "calibration_report": ["report"],
    "logged_scenes": ["scenes as logged"],
    "occupancy_fields": ["overview"],
    "planned_motions": ["first motion"],
    "safety_report": ["plans"],
}
"""Metadata with pictures, by asset."""
MIN_PICTURES = {"calibration_report": 4}
SUMMARY = re.compile(r"[\s\S]{100}")
"""A summary has at least so many characters."""


@pytest.fixture(scope="module")
def outcome(tab, screenshot):
    """Run the whole chain by the most obvious clicks; return the status at its end."""
    tab.goto("/")
    navigate(tab, "Jobs")
    link(tab, "everything").click()
    button(tab, "Materialize all").click()
    dialog_of(tab).get_by_role("button", name="All", exact=True).click()
    screenshot("materialize")
    dialog_of(tab).get_by_role("button", name="Launch backfill").click()
    dialog_of(tab).wait_for(state="detached")
    navigate(tab, "Runs")
    tab.get_by_text("Show runs within backfills").click()
    end_of_run(tab)  # on the list of runs: the page of the run would render every event
    tab.get_by_role("link").filter(has_text=re.compile(r"^[0-9a-f]{8}$")).first.click()
    outcome = end_of_run(tab)
    screenshot("run")
    return outcome


def gate(miou):
    return f"ops:\n  calibration_report_may_be_frozen:\n    config:\n      miou: {miou}\n"


def end_of_a_run_with(page, miou):
    """Materialize the calibration report with that gate; return the status of the run."""
    open_asset(page, "calibration_report")
    launchpad = open_launchpad(page)
    configure(page, gate(miou))
    launchpad.get_by_text("No errors").wait_for()
    launchpad.get_by_role("button", name="Materialize").click()
    return end_of_run(page)


def test_the_catalog_shows_the_chain_by_groups(page, screenshot):
    navigate(page, "Catalog")
    for group, names in CHAIN.items():
        search(page, f'group:"{group}"')
        for name in names:
            link(page, name).wait_for()
        screenshot(f"catalog-{group}")


def test_the_chain_is_materialized_by_clicks(outcome):
    assert outcome == "Success"


def test_every_asset_of_the_chain_is_shown_as_made(page, outcome):
    navigate(page, "Catalog")
    for group, names in CHAIN.items():
        search(page, f'group:"{group}"')
        link(page, names[-1]).wait_for()
        whole = [name for name in names if name != "ensemble_member"]  # the UI counts its partitions instead
        page.get_by_text(re.compile("^Materialized")).nth(len(whole) - 1).wait_for()
        assert page.get_by_text("Never materialized").count() == 0


def test_the_graph_shows_the_whole_chain(page, screenshot, outcome):
    screenshot("graph", open_graph_of_the_chain(page))
    show_navigation(page)


@pytest.mark.parametrize("name", PICTURES)
def test_the_pictures_of_an_asset_can_be_decoded(page, screenshot, outcome, name):
    open_asset(page, name)
    page.get_by_text("digest", exact=True).wait_for()
    screenshot(name)
    for key in PICTURES[name]:
        shown = open_markdown(page, key)
        shown.locator("img").first.wait_for()
        sizes = sizes_of_pictures(shown)
        screenshot(f"{name}-{key}")
        close_dialog(page)
        assert len(sizes) >= MIN_PICTURES.get(name, 1)
        assert all(width >= 200 and height >= 80 for width, height in sizes), sizes


@pytest.mark.parametrize("name", ["calibration_report", "safety_report"])
def test_a_report_shows_its_summary_without_a_click(page, outcome, name):
    open_asset(page, name)
    row = page.get_by_role("row").filter(has=page.get_by_text("summary", exact=True))
    text = row.filter(has_text=SUMMARY).inner_text()  # Markdown is drawn some time after its row
    assert "Show Markdown" not in text


def test_the_launchpad_refuses_a_setting_of_the_wrong_type(page, screenshot, outcome):
    open_asset(page, "calibration_report")
    launchpad = open_launchpad(page)
    configure(page, gate("high"))
    launchpad.get_by_text('Value "high"').wait_for()
    screenshot("launchpad")
    assert "is not valid" in launchpad.inner_text()
    assert launchpad.get_by_role("button", name="Materialize").is_disabled()
    configure(page, gate(0.9))
    launchpad.get_by_text("No errors").wait_for()


def test_an_invalid_value_is_refused_before_anything_is_computed(page, screenshot, outcome):
    assert end_of_a_run_with(page, 3.0) == "Failure"
    page.get_by_text("nothing was run, since settings are wrong").first.wait_for()
    screenshot("refused")
    assert page.get_by_text("miou must be in").first.is_visible()


def test_the_page_of_a_failed_check_gives_the_reason(page, screenshot, outcome):
    assert end_of_a_run_with(page, 0.999) == "Failure"
    open_asset(page, "calibration_report", tab="Checks")
    page.get_by_text("may_be_frozen", exact=True).first.click()
    page.get_by_text(re.compile(r"^mIoU is 0\.\d{4} and must be at least 0\.999$")).wait_for()
    screenshot("check")
