"""The page of a calibrated session in a browser: loading, links, small screens and print."""

from __future__ import annotations

import base64

import pytest
from helpers.browser import CONTRAST, command, complaints, emulate, requests
from helpers.page_calibrations import calibration, solved, write_calibrated
from helpers.page_results import failed
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.wait import WebDriverWait

from dvrk_cmaes.report.page import write_page

pytestmark = pytest.mark.browser

NAMES = [f"{k:02d}" for k in range(20)]
LONG = "a_frame_of_a_very_long_name_that_has_nowhere_to_break_" * 2


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    frames = solved([*NAMES, LONG], {"03": (0.0, 1.0)})
    session = calibration(
        frames,
        left_out={"gone": "no readings of all outer joints (yaw, pitch, insertion, roll)", "lost": "no pose"},
        untold=("offset of insertion: standard deviation 0.50 mm, as wide as expected beforehand",),
        remarks=("the arm's base or the camera moved between frames 04 and 05: 2 bases, and all else is shared",),
    )
    out = tmp_path_factory.mktemp("out")
    return write_page(write_calibrated(out, [*frames, failed("lost")], session, pictures=[*NAMES, LONG])).as_uri()


def opened(page: WebDriver) -> list[str]:
    return page.execute_script(
        "return [...document.querySelectorAll('article details[open] h3')].map((h) => h.textContent)"
    )


def loaded(page: WebDriver, selector: str) -> int:
    """Wait for the requested pictures to load; gives their number."""
    return page.execute_async_script(
        "const done = arguments[1];"
        "const all = [...document.querySelectorAll(arguments[0])];"
        "Promise.allSettled(all.map((image) => image.decode())).then(() =>"
        " done(all.filter((image) => image.naturalWidth > 0).length))",
        selector,
    )


def test_calibration_is_shown_without_errors(page: WebDriver) -> None:
    section = page.find_element(By.ID, "calibration")
    assert section.is_displayed()
    for part in ("This session cannot tell: offset of insertion", "Where the shafts", "Leave one out", "gone"):
        assert part in section.text
    for name in ("offsets", "shafts", "meeting"):
        plot = page.find_element(By.ID, f"plot-{name}")
        assert len(plot.find_elements(By.CSS_SELECTOR, "svg[role=img][aria-label]")) == 2
        assert plot.size["height"] > 150
    assert complaints(page) == []


def test_pictures_of_predictions_are_within_the_page(page: WebDriver) -> None:
    page.execute_script("document.getElementById('calibration').scrollIntoView({block: 'end'})")
    assert loaded(page, ".pictures img") == 12
    card = page.find_element(By.ID, "frame-19")
    card.find_element(By.TAG_NAME, "summary").click()
    assert loaded(page, "#frame-19 .prediction") == 1
    assert not [address for address in requests(page) if "overlays" in address]
    assert complaints(page) == []


def test_pictures_names_and_shafts_link_to_frames(page: WebDriver) -> None:
    for link in (".pictures a[href='#frame-02']", "#calibration th a[href='#frame-lost']"):
        before = len(opened(page))
        page.find_element(By.CSS_SELECTOR, link).click()
        WebDriverWait(page, 60).until(lambda page, before=before: len(opened(page)) > before)
    page.execute_script(
        "document.querySelector('#plot-meeting [data-f=\"7\"]').dispatchEvent(new MouseEvent('click', {bubbles: true}))"
    )
    assert sorted(opened(page)) == ["02", "07", "lost"]


def test_frames_can_be_sorted_by_prediction(page: WebDriver) -> None:
    page.find_element(By.CSS_SELECTOR, "#order option[value='predicted']").click()
    names = page.execute_script("return [...document.querySelectorAll('article h3')].map((h) => h.textContent)")
    assert names == [*NAMES, LONG, "lost"]


@pytest.mark.parametrize("width", [360, 768, 1920])
def test_no_horizontal_overflow(page: WebDriver, width: int) -> None:
    emulate(page, width=width)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.execute_script("return document.documentElement.scrollWidth") == width


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_contrast(page: WebDriver, scheme: str) -> None:
    emulate(page, width=1200, scheme=scheme)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.execute_script(CONTRAST) == []


def test_print_shows_whole_tables(page: WebDriver) -> None:
    pdf = base64.b64decode(command(page, "Page.printToPDF", printBackground=True, preferCSSPageSize=True)["data"])
    assert pdf.startswith(b"%PDF-")
    emulate(page, width=800, media="print", scheme="dark")
    assert page.find_element(By.ID, "plot-shafts").is_displayed()
    for table in page.find_elements(By.CSS_SELECTOR, "#calibration .tall"):
        hidden = page.execute_script("return arguments[0].scrollHeight - arguments[0].clientHeight", table)
        assert hidden == 0
