"""The layout of pages from phones to large screens: nothing overflows, overlaps, is cut off or stands alone."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import VIOLATIONS, complaints, emulate, show_whole
from helpers.canned_results import canned
from helpers.canned_results import write_results as write_canned
from helpers.page_calibrations import cables_of, calibration, solved, write_calibrated
from helpers.page_results import doubtful, failed, overlay, result, write_results
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webdriver import WebDriver

from dvrk_cmaes.cli import main
from dvrk_cmaes.io.atomic import encoded_image, write_image, write_json
from dvrk_cmaes.report.arms_page import write_arms_page
from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.results.layers import FrameLayers, Outline
from dvrk_cmaes.results.paths import layers_path, overlay_path

pytestmark = pytest.mark.browser

WIDTHS = (360, 768, 1280, 1385, 1400, 1920)  # 1385: 1400 less a scrollbar
LONG = "a_frame_of_a_very_long_name_that_has_nowhere_to_break"


def session_page(out: Path) -> Path:
    """Write the page of a batch with ok, doubtful and failed frames."""
    frames = [result(f"{k:04d}", time=k / 30) for k in range(8)] + [result(LONG)]
    frames += [failed("0008", "masks/0008.png: mask is empty: expected pixels above 127, got none")]
    frames += [doubtful("0009", "readings far off: jaw by 40 deg", "twin undecided: the fits are equal")]
    return write_page(write_results(out, frames))


def calibrated_page(out: Path) -> Path:
    """Write the page of a calibrated session with frames left out."""
    frames = solved([*(f"{k:04d}" for k in range(13)), LONG])
    gone = {"gone": "no readings of all outer joints (yaw, pitch, insertion, roll)"}
    session = calibration(frames, left_out=gone, cables=cables_of(frames))
    return write_page(write_calibrated(out, [*frames, failed("lost")], session))


def compared_page(out: Path) -> Path:
    """Write the page of a comparison of three sets."""
    names = [*(f"{k:04d}" for k in range(4)), LONG]
    folders = [write_canned(out / label, *(canned(name, k) for k, name in enumerate(names))) for label in "xyz"]
    for folder in folders:
        for name in names:
            write_image(overlay_path(folder, name), overlay(canned(name)))
    assert main(["compare", *map(str, folders), "--out", str(out / "differences")]) == 0
    return out / "differences" / "compare.html"


def arms_page(out: Path) -> Path:
    """Write the page of a session with two arms."""
    names = [*(f"{k:04d}" for k in range(4)), LONG]
    for name in names:
        write_image(overlay_path(out, name), overlay(canned(name)))
    folders = {arm: read_results(write_canned(out / arm, *map(canned, names))) for arm in ("PSM1", "PSM2")}
    return write_arms_page(out, folders)


@pytest.fixture(scope="module")
def page(request: pytest.FixtureRequest, driver: WebDriver, tmp_path_factory: pytest.TempPathFactory) -> WebDriver:
    """Open a page."""
    make: Callable[[Path], Path] = request.param
    driver.get(make(tmp_path_factory.mktemp("out")).as_uri())
    return driver


@pytest.mark.parametrize("page", [session_page, calibrated_page, compared_page, arms_page], indirect=True)
@pytest.mark.parametrize("width", WIDTHS)
def test_layout_has_no_faults(page: WebDriver, width: int) -> None:
    for opened in ("false", "true"):
        page.execute_script(f"document.querySelectorAll('details').forEach((d) => {{ d.open = {opened}; }})")
        show_whole(page, width=width)
        assert page.execute_script("return document.documentElement.scrollWidth") == width
        assert page.execute_script(VIOLATIONS) == []


@pytest.mark.parametrize("page", [session_page], indirect=True)
@pytest.mark.parametrize("width", [1280, 1400, 1920])
def test_table_of_alternatives_is_shown_whole(page: WebDriver, width: int) -> None:
    show_whole(page, width=width)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    tables = page.find_elements(By.CSS_SELECTOR, "[aria-label=Alternatives]")
    assert tables
    for table in tables:
        assert page.execute_script("return arguments[0].scrollWidth - arguments[0].clientWidth", table) <= 0


def test_faults_are_found(driver: WebDriver, tmp_path: Path) -> None:
    """Elements that are moved, widened or narrowed on a page without faults are named."""
    driver.get(session_page(tmp_path).as_uri())
    emulate(driver, width=1280)
    for change, kind in (
        ("document.querySelector('h1').style.marginLeft = '2000px'", "beyond the page"),
        ("document.querySelector('#frames h2').style.marginBottom = '-40px'", "overlap"),
        ("document.querySelector('#grid').style.gridTemplateColumns = 'repeat(5, 1fr)'", "alone"),
        ("document.querySelectorAll('#plot-rcm .plot').forEach((p) => { p.style.flexBasis = '30rem'; })", "stacked"),
        ("document.querySelector('#plot-rcm .title').setAttribute('x', -9)", "label cut off"),
        ("document.querySelector('#plot-rcm .plot').style.fontSize = '60px'", "labels overlap"),
    ):
        driver.refresh()
        driver.execute_script(change)
        assert kind in {fault[0] for fault in driver.execute_script(VIOLATIONS)}


def test_strips_of_text_are_cut_off_overlays(driver: WebDriver, tmp_path: Path) -> None:
    driver.get(session_page(tmp_path).as_uri())
    emulate(driver, width=1280)
    card = driver.find_element(By.ID, "frame-0000")
    card.find_element(By.TAG_NAME, "summary").click()
    picture = card.find_element(By.CSS_SELECTOR, ".picture img")
    driver.execute_async_script("arguments[0].decode().then(arguments[1], arguments[1])", picture)
    whole, part = picture.rect, card.find_element(By.CSS_SELECTOR, ".crop").rect
    assert part["height"] / part["width"] == pytest.approx(0.75, abs=0.01)
    assert whole["y"] < part["y"]
    assert whole["y"] + whole["height"] > part["y"] + part["height"]
    assert "mask, off in a stretch" in card.find_element(By.CSS_SELECTOR, ".picture .legend").text


def test_picture_is_enlarged_by_a_click(driver: WebDriver, tmp_path: Path) -> None:
    page = session_page(tmp_path)
    driver.get(page.as_uri())
    emulate(driver, width=1280)
    card = driver.find_element(By.ID, "frame-0000")
    card.find_element(By.TAG_NAME, "summary").click()
    picture = card.find_element(By.CSS_SELECTOR, ".picture .crop")
    narrow = picture.rect["width"]
    picture.click()
    assert picture.rect["width"] > 1.7 * narrow
    assert driver.execute_script(VIOLATIONS) == []
    picture.click()
    assert picture.rect["width"] == pytest.approx(narrow)
    assert driver.current_url == page.as_uri()


def test_page_without_its_folder_says_so_and_shows_small_pictures(
    driver: WebDriver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dvrk_cmaes.report.page.EMBEDDED", 0)  # as beyond the first frames of many
    moved = tmp_path / "elsewhere.html"
    session_page(tmp_path / "out").rename(moved)
    driver.get(moved.as_uri())
    card = driver.find_element(By.ID, "frame-0000")
    card.find_element(By.TAG_NAME, "summary").click()
    picture = card.find_element(By.CSS_SELECTOR, ".picture img")
    driver.execute_async_script(
        "setTimeout(() => arguments[0].decode().then(arguments[1], arguments[1]), 500)", picture
    )
    assert driver.execute_script("return arguments[0].naturalWidth", picture) == 288
    assert "overlays/0000.jpg, is not beside this page" in card.find_element(By.CSS_SELECTOR, ".missing").text
    complaints(driver)


def test_layers_of_a_frame_can_be_chosen_and_enlarged(driver: WebDriver, tmp_path: Path) -> None:
    frames = [result("0000")]
    out = write_results(tmp_path / "out", frames)
    ring = (100.0, 100.0, 500.0, 100.0, 300.0, 400.0)
    outlines = tuple(Outline(name, (ring,)) for name in ("mask", "result", "mirror twin"))
    picture = base64.b64encode(encoded_image("a.jpg", np.full((480, 640, 3), 90, np.uint8))).decode()
    write_json(layers_path(out, "0000"), FrameLayers(640, 480, outlines, picture).to_dict())
    moved = tmp_path / "elsewhere.html"  # the layers are within the page
    write_page(out).rename(moved)
    emulate(driver, width=1280)
    driver.get(moved.as_uri())
    complaints(driver)
    card = driver.find_element(By.ID, "frame-0000")
    card.find_element(By.TAG_NAME, "summary").click()
    drawing, overlay_drawn = (card.find_element(By.CSS_SELECTOR, f".stage {kind}") for kind in ("svg", "img"))
    boxes = {box.get_attribute("data-layer"): box for box in card.find_elements(By.CSS_SELECTOR, "[data-layer]")}
    parts = {part.get_attribute("data-part"): part for part in drawing.find_elements(By.CSS_SELECTOR, "[data-part]")}
    assert (drawing.is_displayed(), overlay_drawn.is_displayed()) == (False, True)
    card.find_element(By.CSS_SELECTOR, "[data-view=layers]").click()
    assert (drawing.is_displayed(), overlay_drawn.is_displayed()) == (True, False)
    assert [name for name in parts if parts[name].is_displayed()] == ["p", "0", "1"]  # image, mask and result
    boxes["2"].click()
    assert parts["2"].is_displayed()
    for name in "012":
        boxes[name].click()
    assert [name for name in parts if parts[name].is_displayed()] == ["p"]
    width = drawing.rect["width"]
    for _ in range(3):
        card.find_element(By.CSS_SELECTOR, "[aria-label=Enlarge]").click()
    assert drawing.rect["width"] == pytest.approx(3 * width, rel=0.02)
    assert card.find_element(By.CSS_SELECTOR, ".zoom output").text == "300 %"
    assert driver.execute_script(VIOLATIONS) == []
    for _ in range(3):
        card.find_element(By.CSS_SELECTOR, "[aria-label=Reduce]").click()
    assert drawing.rect["width"] == pytest.approx(width)
    assert complaints(driver) == []
