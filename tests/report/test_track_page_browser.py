"""The page of a followed recording in a browser: cursor, pictures, jumps, zoom, keys, and without scripts."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.browser import CONTRAST, VIOLATIONS, complaints, emulate, requests, show_whole, without_scripts
from helpers.track_rows import recording, row
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver

from dvrk_cmaes.report.track_page import write_track_page

pytestmark = pytest.mark.browser

WIDTHS = (360, 768, 1280, 1385, 1400, 1920)
ODD = "<b>'odd' name #1?"
LONG = "a_frame_of_a_very_long_name_that_has_nowhere_to_break"
SWITCH = "switched to the mirror twin: it explains the images better than the one of the frames before it did"


def page_of(folder: Path) -> str:
    """Write a page of 90 frames: lost from 30 to 39, a switch at 60, gone from 80 on; returns its address."""
    rows = [row(k) for k in range(90)]
    for k in range(30, 40):
        rows[k] = row(k, "lost", "lost: the mask's edges do not support the predicted outline")
    rows[60] = row(60, "doubtful", SWITCH)
    rows[40] = row(40, "doubtful", "found again: one image supports the pose so far", name=ODD)
    rows[80:] = [row(k, "gone", "no mask") for k in range(80, 90)]
    rows[85]["frame"] = LONG
    return write_track_page(folder, recording(rows, session="out é #1")).as_uri()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    return page_of(tmp_path_factory.mktemp("tracks é #1"))


def frame(page: WebDriver) -> str:
    """The frame at the cursor."""
    return page.find_element(By.ID, "at-frame").text


def lines(page: WebDriver) -> list[float]:
    """Places of the cursor's lines in their canvases, px."""
    return page.execute_script(
        "return [...document.querySelectorAll('#charts .cursor')].map((line) =>"
        " line.getBoundingClientRect().left - line.parentElement.getBoundingClientRect().left)"
    )


def picture(page: WebDriver) -> str:
    """The frame of the picture that is marked."""
    return page.find_element(By.CSS_SELECTOR, "#strip .here bdi").get_attribute("textContent") or ""


def press(page: WebDriver, *keys: str) -> None:
    ActionChains(page).send_keys(*keys).perform()


def test_page_opens_without_errors_or_requests(page: WebDriver, report: str) -> None:
    assert page.title == "out é #1: 90 frames followed, 4 places to look at · dvrk-cmaes"
    assert frame(page) == "0000"
    assert complaints(page) == []
    assert requests(page) == [report]


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("at", ["0000", "0060"])
def test_layout_has_no_faults(page: WebDriver, width: int, at: str) -> None:
    emulate(page, width=width)
    page.execute_script(f"location.hash = '#frame-{at}'")
    show_whole(page, width=width)
    assert page.execute_script("return document.documentElement.scrollWidth") == width
    assert page.execute_script(VIOLATIONS) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_have_contrast(page: WebDriver, scheme: str) -> None:
    emulate(page, width=1200, scheme=scheme)
    assert page.execute_script(CONTRAST) == []


def test_cursor_links_curves_and_pictures(page: WebDriver) -> None:
    canvas = page.find_element(By.CSS_SELECTOR, "#chart-tips canvas")
    ActionChains(page).move_to_element_with_offset(canvas, 60, 0).perform()
    place, width = 60 + canvas.size["width"] / 2, canvas.size["width"]
    assert int(frame(page)) == pytest.approx(89 * (place - 52) / (width - 60), abs=1)  # 52 and 8 px beside the curves
    places = lines(page)
    assert places == pytest.approx([places[0]] * len(places), abs=1.5)
    assert places[0] == pytest.approx(place, abs=5)
    assert abs(int(picture(page)) - int(frame(page))) <= 2
    value = page.find_element(By.CSS_SELECTOR, "#chart-spread output").text
    assert value == "0.50"


def test_buttons_go_to_losses_and_switches_and_back(page: WebDriver) -> None:
    seen = []
    for button in ("next", "next", "next", "next", "next", "previous"):
        page.find_element(By.ID, button).click()
        seen.append(frame(page))
    assert seen == ["0030", ODD, "0041", "0060", "0080", "0060"]
    assert page.find_element(By.ID, "at-reasons").text == SWITCH
    assert "doubtful" in page.find_element(By.ID, "at-status").text


def test_links_of_the_table_go_to_frames_and_browser_goes_back(page: WebDriver) -> None:
    page.find_element(By.LINK_TEXT, "0030").click()
    assert frame(page) == "0030"
    page.find_element(By.LINK_TEXT, ODD).click()
    assert frame(page) == ODD
    page.back()
    assert frame(page) == "0030"


def test_picture_is_a_link_to_its_frame(page: WebDriver) -> None:
    page.find_element(By.CSS_SELECTOR, "#strip li:nth-child(3) a").click()
    assert (frame(page), picture(page)) == ("0006", "0006")


def test_keys_move_the_cursor(page: WebDriver) -> None:
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_LEFT)
    assert frame(page) == "0001"
    press(page, "n")
    assert frame(page) == "0030"
    press(page, "p", Keys.ARROW_LEFT)
    assert frame(page) == "0029"


def test_part_is_enlarged_by_dragging_and_all_is_shown_again(page: WebDriver) -> None:
    canvas = page.find_element(By.CSS_SELECTOR, "#chart-joints canvas")
    quarter = canvas.size["width"] // 4
    drag = ActionChains(page).move_to_element_with_offset(canvas, -quarter, 0).click_and_hold()
    drag.move_by_offset(quarter, 0).release().perform()
    press(page, *[Keys.ARROW_LEFT] * 30)
    before = lines(page)[0]
    press(page, Keys.ARROW_RIGHT)
    page.execute_async_script("requestAnimationFrame(arguments[0])")
    enlarged = lines(page)[0] - before
    page.find_element(By.ID, "all").click()
    page.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
    before = lines(page)[0]
    press(page, Keys.ARROW_RIGHT)
    assert enlarged > 3 * (lines(page)[0] - before) > 0


def test_curves_are_drawn_where_the_values_are(page: WebDriver) -> None:
    """The status band has the colour of each status at the frames that have it."""
    colours = page.execute_script(
        "const band = document.getElementById('band'); const pen = band.getContext('2d');"
        "const at = (k) => 52 + (k / 89) * (band.clientWidth - 60);"
        "return [10, 35, 85].map((k) => [...pen.getImageData(Math.round(at(k)), 8, 1, 1).data].slice(0, 3))"
    )
    wanted = page.execute_script(
        "return ['--ok', '--failed', '--quiet'].map((name) => {"
        "const pen = document.createElement('canvas').getContext('2d');"
        "pen.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(name).trim();"
        "pen.fillRect(0, 0, 1, 1);"
        "return [...pen.getImageData(0, 0, 1, 1).data].slice(0, 3) })"
    )
    assert colours == wanted


def test_page_can_be_read_without_scripts(driver: WebDriver, report: str) -> None:
    with without_scripts(driver, report) as page:
        assert "drawn by a script" in page.find_element(By.TAG_NAME, "noscript").text
        assert not page.find_element(By.ID, "player").is_displayed()
        assert len(page.find_elements(By.CSS_SELECTOR, "#events tbody tr")) == 4
        assert len(page.find_elements(By.CSS_SELECTOR, "#strip img")) == 30
