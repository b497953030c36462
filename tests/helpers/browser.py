"""Headless Chromium driven by Selenium, for tests of pages.

On Debian: ``apt-get install chromium chromium-driver``.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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
def chromium(profile: Path) -> Iterator[WebDriver]:
    """Run headless Chromium with a new profile. Selenium takes half a second to import in each process of tests."""
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    browser, server = shutil.which("chromium"), shutil.which("chromedriver")
    assert browser is not None
    assert server is not None
    options = Options()
    options.binary_location = browser
    for flag in (*_FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(executable_path=server))
    try:
        yield driver
    finally:
        driver.quit()


def complaints(driver: WebDriver) -> list[str]:
    """Give the console messages since the last call."""
    return [entry["message"] for entry in driver.get_log("browser")]


def requests(driver: WebDriver) -> list[str]:
    """Give the addresses requested since the last call, without data URLs."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    addresses = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
    return [address for address in addresses if not address.startswith("data:")]


def command(driver: WebDriver, name: str, **parameters: Any) -> Any:
    """Send a command of the Chrome DevTools Protocol."""
    return driver.execute_cdp_cmd(name, parameters)  # type: ignore[attr-defined]


@contextmanager
def without_scripts(driver: WebDriver, address: str) -> Iterator[WebDriver]:
    """Load a page without JavaScript."""
    command(driver, "Emulation.setScriptExecutionDisabled", value=True)
    try:
        driver.get(address)
        yield driver
    finally:
        command(driver, "Emulation.setScriptExecutionDisabled", value=False)


def emulate(driver: WebDriver, *, width: int, height: int = 900, media: str = "", scheme: str = "light") -> None:
    """Emulate a screen size, px, a ``media`` type and a preferred colour ``scheme``."""
    command(driver, "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    command(driver, "Emulation.setEmulatedMedia", media=media, features=features)


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
"""Script that returns the texts with a contrast below 4.5, the minimum of WCAG 2.2."""
