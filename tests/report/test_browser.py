"""Pages in a browser: they need no network, show overlays, find frames, and play recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from helpers.browser import CONTRAST, complaints, emulate, requests, without_scripts
from helpers.page_calibrations import calibration, solved, write_calibrated
from helpers.page_results import doubtful, failed, result, write_results
from helpers.track_rows import recording, row

from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.report.template import write
from dvrk_cmaes.report.track_page import PAGE, track_page

if TYPE_CHECKING:
    from selenium.webdriver.remote.webdriver import WebDriver

pytestmark = pytest.mark.browser

BROKEN = "return [...document.images].filter((image) => !image.complete || !image.naturalWidth).length"
SHOWN = "return [...document.querySelectorAll('article')].filter((one) => one.checkVisibility()).map((one) => one.id)"
WIDE = "return document.documentElement.scrollWidth"
FRAMES = [
    result("fine"),
    doubtful("odd", "readings far off: jaw by 40 deg"),
    failed("torn", "masks/torn.png: mask is empty: expected pixels above 127, got none"),
]


@pytest.fixture
def report(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The address of a page of the kind that a test asks for."""
    if request.param == "session":
        path = write_page(write_results(tmp_path, FRAMES))
    elif request.param == "calibrated":
        frames = solved([f"a_frame_of_a_long_name_{k:04d}" for k in range(7)])
        path = write_page(write_calibrated(tmp_path, frames, calibration(frames)))
    else:
        rows = [row(k, *(("lost", "lost: no edges") if 3 <= k < 6 else ("ok",))) for k in range(30)]
        path = write(tmp_path / PAGE, track_page(recording(rows)))
    return path.as_uri()


ALL = pytest.mark.parametrize("report", ["session", "calibrated", "track"], indirect=True)


@ALL
def test_page_needs_no_network_and_its_pictures_are_shown(page: WebDriver, report: str) -> None:
    page.execute_script("for (const image of document.images) image.loading = 'eager'")
    page.execute_async_script("Promise.all([...document.images].map((i) => i.decode())).then(arguments[0])")
    assert page.execute_script(BROKEN) == 0
    assert [address for address in requests(page) if not address.startswith("file:")] == []
    assert complaints(page) == []


@ALL
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_fits_a_phone_and_its_texts_have_contrast(page: WebDriver, report: str, scheme: str) -> None:
    emulate(page, width=390, scheme=scheme)
    assert page.execute_script(WIDE) <= 390
    assert page.execute_script(CONTRAST) == []


@pytest.mark.parametrize("report", ["session"], indirect=True)
def test_worst_frame_is_first_and_frames_are_found_by_a_reason(page: WebDriver, report: str) -> None:
    assert page.execute_script(SHOWN) == ["frame-torn", "frame-odd", "frame-fine"]
    page.find_element("partial link text", "readings far off").click()
    assert page.execute_script(SHOWN) == ["frame-odd"]
    assert page.find_element("id", "found").text == "1 of 3"
    page.find_element("css selector", "#frame-odd summary").click()
    assert "wrist_pitch" in page.find_element("id", "frame-odd").text


@pytest.mark.parametrize("report", ["track"], indirect=True)
def test_recording_plays_and_a_click_in_a_curve_goes_there(page: WebDriver, report: str) -> None:
    where = page.find_element("id", "where")
    assert where.text == "0000, ok"
    page.find_element("id", "play").click()
    page.execute_async_script("setTimeout(arguments[0], 2500)")
    assert where.text == "0027, ok"
    assert page.find_element("id", "play").text == "play"
    page.find_element("css selector", "[data-seek]").click()
    assert where.text == "0003, lost"
    assert page.execute_script("return shown.src && shown.src === document.querySelector('article img').src")
    page.find_element("css selector", "svg[data-seeks]").click()  # in its middle
    assert where.text in ("0012, ok", "0015, ok")


@pytest.mark.parametrize("report", ["session"], indirect=True)
def test_page_can_be_read_without_scripts(driver: WebDriver, report: str) -> None:
    with without_scripts(driver, report) as page:
        assert [one.text for one in page.find_elements("css selector", "article h3 bdi")] == ["torn", "odd", "fine"]
        assert page.find_element("css selector", "svg.chart").is_displayed()
