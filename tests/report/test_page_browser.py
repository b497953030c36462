"""The page in a browser: offline, with keyboard, links, print, small screens, and without JavaScript."""

from __future__ import annotations

import base64
import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import CONTRAST, command, complaints, emulate, requests, without_scripts
from helpers.page_results import doubtful, failed, overlay, result, write_results
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.remote.webelement import WebElement

from dvrk_cmaes.draw.canvas import AXES
from dvrk_cmaes.io.atomic import write_image
from dvrk_cmaes.report import page_layers, page_thumbnails
from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.report.page_layers import EMBEDDED
from dvrk_cmaes.report.page_thumbnails import webp_address

pytestmark = pytest.mark.browser

ODD = "<script>document.title='taken'<script> \"größe\" #1?"
BY_DOUBT = ["no pose", "two reasons", ODD, "least", "a", "b", "c", "d", "e", "f"]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    frames = [result(name, seconds=10.0 - k) for k, name in enumerate("fedcba")]
    frames += [failed("no pose"), doubtful("two reasons", "twin undecided: x", "far: jaw"), doubtful(ODD, "far: yaw")]
    frames += [doubtful("least", "far: jaw", iou=0.95)]
    return write_page(write_results(tmp_path_factory.mktemp("out é #1"), frames)).as_uri()


def shown(page: WebDriver) -> list[str]:
    """Give the visible frames in order."""
    return page.execute_script(
        "return [...document.querySelectorAll('article')].filter((a) => a.checkVisibility())"
        ".map((a) => a.querySelector('h3').textContent)"
    )


def opened(page: WebDriver) -> list[str]:
    return page.execute_script(
        "return [...document.querySelectorAll('article details[open] h3')].map((h) => h.textContent)"
    )


def focused(page: WebDriver) -> str:
    return page.execute_script("return document.activeElement.querySelector('h3')?.textContent")


def press(page: WebDriver, *keys: str) -> None:
    for key in keys:
        page.switch_to.active_element.send_keys(key)


def width_of(page: WebDriver, picture: WebElement) -> int:
    """Wait for a picture to load; gives its natural width, px."""
    page.execute_async_script("arguments[0].decode().then(arguments[1], arguments[1])", picture)
    return page.execute_script("return arguments[0].naturalWidth", picture)


def worked(page: WebDriver) -> float:
    """Give the CPU time of the page's main thread, s, which does not depend on other processes."""
    metrics = command(page, "Performance.getMetrics")["metrics"]
    return next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration")


def choose(page: WebDriver, order: str) -> None:
    page.find_element(By.CSS_SELECTOR, f"#order option[value='{order}']").click()


def test_page_opens_without_errors_or_requests(page: WebDriver, report: str) -> None:
    assert page.title == "10 frames, 4 to look at · dvrk-cmaes"
    assert shown(page) == BY_DOUBT
    assert complaints(page) == []
    assert requests(page) == [report]


def test_overlay_is_shown_when_frame_is_opened(page: WebDriver) -> None:
    for picture in page.find_elements(By.CSS_SELECTOR, "summary img"):
        page.execute_script("arguments[0].scrollIntoView()", picture)
        assert width_of(page, picture) == 288
    requests(page)
    card = page.find_elements(By.CSS_SELECTOR, "article")[2]
    card.find_element(By.TAG_NAME, "summary").click()
    picture = card.find_element(By.CSS_SELECTOR, ".picture img")
    assert width_of(page, picture) == 640
    assert requests(page) == []  # it is within the page
    assert (
        card.find_element(By.CSS_SELECTOR, ".picture a")
        .get_attribute("href")
        .endswith("overlays/%3Cscript%3Edocument.title%3D%27taken%27%3Cscript%3E%20%22gr%C3%B6%C3%9Fe%22%20%231%3F.jpg")
    )
    assert complaints(page) == []


def test_keyboard_navigation(page: WebDriver) -> None:
    press(page, "j")
    assert focused(page) == BY_DOUBT[0]
    press(page, "j", Keys.ARROW_RIGHT, "k")
    assert focused(page) == BY_DOUBT[1]
    press(page, Keys.ENTER)
    assert opened(page) == [BY_DOUBT[1]]
    press(page, "j")
    assert (focused(page), opened(page)) == (BY_DOUBT[2], [BY_DOUBT[2]])
    press(page, Keys.ESCAPE)
    assert (focused(page), opened(page)) == (BY_DOUBT[2], [])
    press(page, *"kkkkk")
    assert focused(page) == BY_DOUBT[0]


def test_up_and_down_keys_move_by_rows(page: WebDriver) -> None:
    columns = page.execute_script(
        "return getComputedStyle(document.getElementById('grid')).gridTemplateColumns.split(' ').length"
    )
    assert columns > 1
    press(page, "j", Keys.ARROW_DOWN)
    assert focused(page) == BY_DOUBT[columns]
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_UP)
    assert focused(page) == BY_DOUBT[1]


def test_focus_is_visible(page: WebDriver) -> None:
    press(page, "j")
    outline = page.execute_script("return getComputedStyle(document.activeElement).outline")
    assert "solid" in outline


@pytest.mark.parametrize(
    ("order", "first"), [("place", ODD), ("iou", "two reasons"), ("-seconds", "f"), ("-contour", "two reasons")]
)
def test_frames_can_be_sorted(page: WebDriver, order: str, first: str) -> None:
    choose(page, order)
    assert shown(page)[0] == first
    assert sorted(shown(page)) == sorted(BY_DOUBT)
    choose(page, "doubt")
    assert shown(page) == BY_DOUBT


def test_frames_without_value_are_sorted_last(page: WebDriver) -> None:
    for order in ("iou", "-contour", "-correction", "-rcm"):
        choose(page, order)
        assert shown(page)[-1] == "no pose"


def test_frames_can_be_filtered_by_status_and_text(page: WebDriver) -> None:
    page.find_element(By.CSS_SELECTOR, "[name=status][value=ok]").click()
    assert shown(page) == BY_DOUBT[:4]
    press(page, Keys.ESCAPE)
    page.find_element(By.ID, "find").send_keys("FAR: yaw")
    assert shown(page) == [ODD]
    assert page.find_element(By.ID, "shown").text == "1 of 10"
    page.find_element(By.ID, "find").send_keys(" nowhere")
    assert page.find_element(By.ID, "none").is_displayed()
    page.find_element(By.ID, "find").send_keys(Keys.ESCAPE)
    assert shown(page) == BY_DOUBT[:4]


def test_typing_in_search_field_does_not_navigate(page: WebDriver) -> None:
    press(page, "/")
    press(page, "j", "k", "/")
    assert page.switch_to.active_element.get_attribute("value") == "jk/"


def test_reason_links_to_its_frames(page: WebDriver) -> None:
    page.find_element(By.CSS_SELECTOR, "[data-find='twin undecided']").click()
    assert shown(page) == ["two reasons"]


def test_address_with_anchor_opens_frame(driver: WebDriver, report: str, page: WebDriver) -> None:
    anchor = page.find_elements(By.CSS_SELECTOR, "article")[2].get_attribute("id")
    driver.get("about:blank")
    driver.get(f"{report}#{anchor}")
    assert opened(driver) == [ODD]


def test_plot_mark_links_to_its_frame(page: WebDriver) -> None:
    name = page.execute_script(
        "const mark = document.querySelector('#plot-rcm [data-f]');"
        "mark.dispatchEvent(new PointerEvent('pointerover', {bubbles: true}));"
        "mark.dispatchEvent(new MouseEvent('click', {bubbles: true}));"
        "return document.getElementById('tip').textContent"
    )
    assert name == f"{opened(page)[0]}, doubtful"


def test_scene_in_space_can_be_turned(page: WebDriver) -> None:
    canvas = page.find_element(By.ID, "scene")
    assert canvas.is_displayed()
    pictures = [page.execute_script("return arguments[0].toDataURL()", canvas)]
    assert len(pictures[0]) > 3000  # something is drawn
    ActionChains(page).drag_and_drop_by_offset(canvas, 60, 20).perform()
    pictures.append(page.execute_script("return arguments[0].toDataURL()", canvas))
    canvas.send_keys(Keys.ARROW_LEFT)
    pictures.append(page.execute_script("return arguments[0].toDataURL()", canvas))
    canvas.send_keys("+")
    pictures.append(page.execute_script("return arguments[0].toDataURL()", canvas))
    canvas.send_keys(Keys.SHIFT, Keys.ARROW_LEFT)
    pictures.append(page.execute_script("return arguments[0].toDataURL()", canvas))
    assert len(set(pictures)) == 5
    ActionChains(page).double_click(canvas).perform()
    assert page.execute_script("return arguments[0].toDataURL()", canvas) == pictures[0]
    assert complaints(page) == []


LEFTMOST = """
const canvas = arguments[0], found = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
let least = canvas.width;
for (let k = 3; k < found.length; k += 4) if (found[k]) least = Math.min(least, ((k - 3) / 4) % canvas.width);
return least;
"""


def test_scene_in_space_is_moved_by_dragging_with_shift(page: WebDriver) -> None:
    canvas = page.find_element(By.ID, "scene")
    before = page.execute_script(LEFTMOST, canvas)
    drag = ActionChains(page).key_down(Keys.SHIFT).drag_and_drop_by_offset(canvas, 40, 10).key_up(Keys.SHIFT)
    drag.perform()
    assert page.execute_script(LEFTMOST, canvas) == pytest.approx(before + 40, abs=2)


def test_axes_in_space_have_the_colours_of_the_overlay(page: WebDriver) -> None:
    canvas = page.find_element(By.ID, "scene")
    found = page.execute_script(
        "const canvas = arguments[0], ends = {}, pen = CanvasRenderingContext2D.prototype, write = pen.fillText;"
        "pen.fillText = function (words, u, v) { ends[words] = this.fillStyle; return write.call(this, words, u, v); };"
        "window.dispatchEvent(new Event('resize')); pen.fillText = write; return ends;",
        canvas,
    )
    for name, (blue, green, red) in AXES:
        shown = [int(found[name][k : k + 2], 16) for k in (1, 3, 5)]
        assert np.argmax(shown) == np.argmax([red, green, blue])


def test_other_scripts_are_blocked(page: WebDriver) -> None:
    page.execute_script(
        "const s = document.createElement('script'); s.textContent = 'window.strange = 1'; document.body.append(s)"
    )
    assert page.execute_script("return window.strange") is None
    assert "Content Security Policy" in complaints(page)[0]


def test_print_hides_controls(page: WebDriver) -> None:
    pdf = base64.b64decode(command(page, "Page.printToPDF", printBackground=True, preferCSSPageSize=True)["data"])
    assert pdf.startswith(b"%PDF-")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 4
    emulate(page, width=800, media="print", scheme="dark")
    assert not page.find_element(By.ID, "tools").is_displayed()
    assert not page.find_element(By.TAG_NAME, "nav").is_displayed()
    assert page.find_element(By.ID, "plot-rcm").is_displayed()
    assert page.execute_script("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


@pytest.mark.parametrize("width", [360, 768, 1920])
def test_no_horizontal_overflow(page: WebDriver, width: int) -> None:
    emulate(page, width=width)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert page.execute_script("return document.documentElement.scrollWidth") == width


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_contrast(page: WebDriver, scheme: str) -> None:
    emulate(page, width=1200, scheme=scheme)
    page.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    weak = page.execute_script(CONTRAST)
    assert weak == []


def test_controls_have_names_and_parts_are_landmarks(page: WebDriver) -> None:
    names = page.execute_script(
        "return [...document.querySelectorAll('select, input')].map((e) => e.labels[0]?.textContent.trim() ?? '')"
    )
    assert all(names)
    for landmark in ("header", "nav", "main", "footer"):
        assert len(page.find_elements(By.TAG_NAME, landmark)) == 1
    for plot in page.find_elements(By.CSS_SELECTOR, "svg.plot"):
        assert plot.get_attribute("role") == "img"
        assert plot.get_attribute("aria-label")


def test_page_is_readable_without_javascript(driver: WebDriver, report: str) -> None:
    with without_scripts(driver, report) as page:
        headings = page.find_elements(By.CSS_SELECTOR, "article h3")
        assert [heading.text for heading in headings] == BY_DOUBT
        assert not page.find_element(By.ID, "tools").is_displayed()
        page.find_elements(By.CSS_SELECTOR, "article summary")[1].click()
        body = page.find_elements(By.CSS_SELECTOR, "article .body")[1]
        assert body.is_displayed()
        assert "twin undecided: x" in body.text


def test_thousand_frames_load_and_scroll_quickly(
    driver: WebDriver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded = cache(lambda data, shape, quality: webp_address(np.frombuffer(data, np.uint8).reshape(shape), quality))
    for module in (page_thumbnails, page_layers):  # it is the same picture each time
        monkeypatch.setattr(module, "webp_address", lambda one, quality: encoded(one.tobytes(), one.shape, quality))
    document = doubtful("x", "far: jaw", "far: yaw").to_dict()
    picture = tmp_path / "picture.jpg"
    write_image(picture, overlay(doubtful("x", "far: jaw", "far: yaw"), width=400))
    (tmp_path / "overlays").mkdir()
    (tmp_path / "frames").mkdir()
    for k in range(1000):
        (tmp_path / "frames" / f"{k:04d}.json").write_text(json.dumps(document | {"frame": f"{k:04d}"}))
        (tmp_path / "overlays" / f"{k:04d}.jpg").hardlink_to(picture)
    path = write_page(tmp_path)
    assert path.stat().st_size < 18e6 + EMBEDDED
    emulate(driver, width=1200)
    driver.get("about:blank")
    command(driver, "Performance.enable", timeDomain="threadTicks")
    driver.get(path.as_uri())
    loaded = worked(driver)
    assert 0.05 < loaded < 3
    driver.execute_async_script(SCROLL)
    # relative to loading, which takes the longer the slower the processor is: 50 ms where loading takes a second
    assert (worked(driver) - loaded) / SCREENS < 0.05 * loaded
    assert len(shown(driver)) == 1000


SCREENS = 60
SCROLL = f"""
let left = {SCREENS};
const step = () => {{
  scrollBy(0, 800);
  left -= 1;
  if (left > 0) requestAnimationFrame(step);
  else arguments[0]();
}};
requestAnimationFrame(step);
"""
"""Scroll through SCREENS screens, one per animation frame."""
