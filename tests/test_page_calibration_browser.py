"""A calibrated session's page in a real browser: light, led through by its drawings, on a phone and on paper."""

from __future__ import annotations

import base64
from collections.abc import Iterator

import pytest
from browser import CONTRAST, chromium, command, complaints, emulate, requests
from page_calibrations import calibration, solved, write_calibrated
from page_results import failed
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.wait import WebDriverWait

from dvrk_cmaes.report.page import write_page

NAMES = [f"{k:02d}" for k in range(20)]
LONG = "a_frame_of_a_very_long_name_that_has_nowhere_to_break_" * 2


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    frames = solved([*NAMES, LONG], {"03": (0.0, 1.0)})
    session = calibration(
        frames,
        left_out={"gone": "no readings of all outer joints (yaw, pitch, insertion, roll)", "lost": "no pose"},
        untold=("offset of insertion: standard deviation 0.50 mm, as wide as expected beforehand",),
        warnings=("the arm's base or the camera moved between frames 04 and 05: calibrated for the last of them",),
    )
    out = tmp_path_factory.mktemp("out")
    return write_page(write_calibrated(out, [*frames, failed("lost")], session, pictures=[*NAMES, LONG])).as_uri()


@pytest.fixture
def page(driver: WebDriver, report: str) -> WebDriver:
    """The report, opened anew at a desk's width."""
    emulate(driver, width=1200)
    driver.get("about:blank")
    complaints(driver), requests(driver)
    driver.get(report)
    return driver


def opened(page: WebDriver) -> list[str]:
    return page.execute_script(
        "return [...document.querySelectorAll('article details[open] h3')].map((h) => h.textContent)"
    )


def loaded(page: WebDriver, selector: str) -> int:
    """How many pictures have come, once those that were asked for have."""
    return page.execute_async_script(
        "const done = arguments[1];"
        "const all = [...document.querySelectorAll(arguments[0])];"
        "Promise.allSettled(all.map((image) => image.decode())).then(() =>"
        " done(all.filter((image) => image.naturalWidth > 0).length))",
        selector,
    )


def test_the_calibration_is_shown_without_a_complaint(page: WebDriver) -> None:
    section = page.find_element(By.ID, "calibration")
    assert section.is_displayed()
    for part in ("This session cannot tell: offset of insertion", "Where the shafts", "Leave one out", "gone"):
        assert part in section.text
    for name in ("offsets", "shafts", "meeting"):
        plot = page.find_element(By.ID, f"plot-{name}")
        assert len(plot.find_elements(By.CSS_SELECTOR, "svg[role=img][aria-label]")) == 2
        assert plot.size["height"] > 150
    assert complaints(page) == []


def test_only_the_worst_predictions_are_fetched_until_a_frame_is_opened(page: WebDriver) -> None:
    page.execute_script("document.getElementById('calibration').scrollIntoView({block: 'end'})")
    assert loaded(page, ".pictures img") == 12
    asked = [address for address in requests(page) if "overlays" in address]
    assert len(asked) == 12
    card = page.find_element(By.ID, "frame-19")
    card.find_element(By.TAG_NAME, "summary").click()
    assert loaded(page, "#frame-19 .prediction") == 1
    assert {address.split("/")[-2] for address in requests(page)} == {"overlays", "overlays_left_out"}
    assert complaints(page) == []


def test_pictures_names_and_shafts_lead_to_their_frames(page: WebDriver) -> None:
    for link in (".pictures a[href='#frame-02']", "#calibration th a[href='#frame-lost']"):
        before = len(opened(page))
        page.find_element(By.CSS_SELECTOR, link).click()
        WebDriverWait(page, 10).until(lambda page, before=before: len(opened(page)) > before)
    page.execute_script(
        "document.querySelector('#plot-meeting [data-f=\"7\"]').dispatchEvent(new MouseEvent('click', {bubbles: true}))"
    )
    assert sorted(opened(page)) == ["02", "07", "lost"]


def test_frames_can_be_ordered_by_how_badly_they_are_predicted(page: WebDriver) -> None:
    page.find_element(By.CSS_SELECTOR, "#order option[value='predicted']").click()
    names = page.execute_script("return [...document.querySelectorAll('article h3')].map((h) => h.textContent)")
    assert names == [*NAMES, LONG, "lost"]


@pytest.mark.parametrize("width", [360, 768, 1920])
def test_nothing_sticks_out_at_the_side(page: WebDriver, width: int) -> None:
    emulate(page, width=width)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.execute_script("return document.documentElement.scrollWidth") == width


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(page: WebDriver, scheme: str) -> None:
    emulate(page, width=1200, scheme=scheme)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.execute_script(CONTRAST) == []


def test_on_paper_the_whole_table_is_there(page: WebDriver) -> None:
    pdf = base64.b64decode(command(page, "Page.printToPDF", printBackground=True, preferCSSPageSize=True)["data"])
    assert pdf.startswith(b"%PDF-")
    emulate(page, width=800, media="print", scheme="dark")
    assert page.find_element(By.ID, "plot-shafts").is_displayed()
    for table in page.find_elements(By.CSS_SELECTOR, "#calibration .tall"):
        hidden = page.execute_script("return arguments[0].scrollHeight - arguments[0].clientHeight", table)
        assert hidden == 0
