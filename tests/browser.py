"""A real browser for tests of pages: headless Chromium, driven by Selenium, without a network.

On Debian: ``apt-get install chromium chromium-driver``.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.remote.webdriver import WebDriver

_FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)


@contextmanager
def chromium(profile: Path, *, scripts: bool = True) -> Iterator[WebDriver]:
    """Run Chromium with a new profile; where it is missing, tests fail if ``CI=true``, and else say what they need."""
    programs = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if None in programs:
        message = "needs chromium and chromedriver (Debian: apt-get install chromium chromium-driver)"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    options = Options()
    options.binary_location = str(programs[0])
    for flag in (*_FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    if not scripts:
        options.add_experimental_option("prefs", {"profile.managed_default_content_settings.javascript": 2})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(executable_path=str(programs[1])))
    try:
        yield driver
    finally:
        driver.quit()


def complaints(driver: WebDriver) -> list[str]:
    """Take what the page has written to the console since it was last asked."""
    return [entry["message"] for entry in driver.get_log("browser")]


def requests(driver: WebDriver) -> list[str]:
    """Take the addresses that pages have asked for since it was last asked, but for what they hold themselves."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    addresses = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [address for address in addresses if not address.startswith("data:")]


def command(driver: WebDriver, name: str, **parameters: Any) -> Any:
    """Send a command of the Chrome DevTools Protocol."""
    return driver.execute_cdp_cmd(name, parameters)  # type: ignore[attr-defined]


def emulate(driver: WebDriver, *, width: int, height: int = 900, media: str = "", scheme: str = "light") -> None:
    """Show pages as on a screen of a size, px, or for ``media``, to somebody who likes the colour ``scheme``."""
    command(driver, "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    command(driver, "Emulation.setEmulatedMedia", media=media, features=features)


def screenshot(driver: WebDriver, path: Path, *, width: int, scheme: str = "light") -> None:
    """Take a picture of the whole page at a width, px."""
    emulate(driver, width=width, scheme=scheme)
    height = driver.execute_script("return document.documentElement.scrollHeight")
    emulate(driver, width=width, height=height, scheme=scheme)
    path.write_bytes(base64.b64decode(command(driver, "Page.captureScreenshot", format="png")["data"]))


CONTRAST = """
const parse = (text) => text.match(/[0-9.]+/g).map(Number);
const luminance = ([r, g, b]) => {
  const [R, G, B] = [r, g, b].map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
  return 0.2126 * R + 0.7152 * G + 0.0722 * B;
};
const ground = (element) => {
  for (let e = element; e; e = e.parentElement) {
    const colour = parse(getComputedStyle(e).backgroundColor);
    if (colour.length === 3 || colour[3] > 0) return colour;
  }
};
const weak = [];
for (const element of document.querySelectorAll("body *")) {
  const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  if (!own || !element.checkVisibility() || element.closest("script")) continue;
  const style = getComputedStyle(element);
  const ink = parse(element.closest("svg") ? style.fill : style.color);
  const [a, b] = [luminance(ink), luminance(ground(element))].sort((x, y) => y - x);
  const ratio = (a + 0.05) / (b + 0.05);
  if (ratio < 4.5) weak.push([element.textContent.slice(0, 40), element.className, ratio]);
}
return weak;
"""
"""Texts with less contrast than 4.5, which WCAG 2.2 asks for."""
