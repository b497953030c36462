"""Headless Chromium driven by Selenium, for tests of pages.

On Debian: ``apt-get install chromium chromium-driver``.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

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
def chromium(profile: Path) -> Iterator[WebDriver]:
    """Run headless Chromium with a new profile."""
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


def show_whole(driver: WebDriver, *, width: int) -> None:
    """Emulate a screen of a width, px, that is as high as the page, and wait until all of the page is laid out."""
    emulate(driver, width=width)
    emulate(driver, width=width, height=driver.execute_script("return document.documentElement.scrollHeight"))
    # in the first frame, the articles that were out of sight (content-visibility) come into sight
    driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")


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

VIOLATIONS = """
const width = document.documentElement.clientWidth;
const found = [];
const named = (element) => {
  const place = element.id ? `#${element.id}` : `.${element.getAttribute("class") || ""}`;
  return `${element.tagName.toLowerCase()}${place} ${element.textContent.trim().replace(/\\s+/g, " ").slice(0, 40)}`;
};
const shown = (element) => element.checkVisibility({visibilityProperty: true, contentVisibilityAuto: false});
const rows = (elements) => {
  const tops = new Map();
  for (const element of elements) {
    const top = Math.round(element.getBoundingClientRect().top);
    tops.set(top, [...(tops.get(top) || []), element]);
  }
  return [...tops.entries()].sort((a, b) => a[0] - b[0]).map((entry) => entry[1]);
};
const area = (a, b) => {
  const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
  const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
  return wide > 1 && high > 1 ? wide * high : 0;
};
for (const element of document.querySelectorAll("body *")) {
  if (!shown(element) || element.closest("svg svg, script, .skip")) continue;
  const box = element.getBoundingClientRect();
  if (!box.width || !box.height) continue;
  const inside = element.parentElement.closest(".scroll, .crop, .stage, pre");
  if (!inside && (box.left < -1 || box.right > width + 1)) found.push(["beyond the page", named(element)]);
  const style = getComputedStyle(element);
  const hides = style.overflowX === "hidden" && style.display !== "inline" && !element.matches(".crop");
  if (hides && element.scrollWidth > element.clientWidth + 1) found.push(["cut off", named(element)]);
  const parts = [...element.children].filter((part) => {
    const own = getComputedStyle(part);
    return shown(part) && !["absolute", "fixed", "sticky"].includes(own.position) && own.display !== "inline";
  });
  if (element.closest("svg") || parts.length > 400) continue;
  const boxes = parts.map((part) => part.getBoundingClientRect());
  for (let i = 0; i < parts.length; i += 1)
    for (let j = i + 1; j < parts.length; j += 1)
      if (area(boxes[i], boxes[j])) found.push(["overlap", named(parts[i]), named(parts[j])]);
}
for (const plot of document.querySelectorAll("svg.plot")) {
  if (!shown(plot)) continue;
  const labels = [...plot.querySelectorAll("text")];
  const boxes = labels.map((label) => label.getBoundingClientRect());
  if (labels.length && plot.getScreenCTM().a * parseFloat(getComputedStyle(labels[0]).fontSize) < 9)
    found.push(["small", plot.parentElement.id]);
  const whole = plot.getBoundingClientRect();
  for (let i = 0; i < labels.length; i += 1) {
    const {left, right, top, bottom} = boxes[i];
    const over = Math.max(whole.left - left, right - whole.right, whole.top - top, bottom - whole.bottom);
    if (over > 1) found.push(["label cut off", named(labels[i])]);
    for (let j = i + 1; j < labels.length; j += 1)
      if (area(boxes[i], boxes[j])) found.push(["labels overlap", named(labels[i]), named(labels[j])]);
  }
}
for (const panels of document.querySelectorAll(".panels")) {
  const plots = [...panels.children].filter(shown);
  const beside = panels.closest(".plots") && getComputedStyle(panels.closest(".plots")).columnCount !== "1";
  if (plots.length > 1 && width >= 768 && beside && rows(plots)[0].length < 2) found.push(["stacked", panels.id]);
}
for (const tiles of document.querySelectorAll(".figures, .pictures, #grid")) {
  if (!shown(tiles) || tiles.querySelector("article details[open]")) continue;
  const lines = rows([...tiles.children].filter(shown));
  const last = lines[lines.length - 1];
  if (lines.length < 2 || last.length > 1 || lines[0].length < 3) continue;
  const wide = last[0].getBoundingClientRect().width;
  if (wide < 0.9 * tiles.clientWidth) found.push(["alone", named(last[0])]);
}
return found;
"""
"""Script that returns the faults of a page's layout, each as its kind and the elements concerned.

Looked for are elements beyond the sides of the page, text and labels of plots that are cut off, elements and labels
that overlap, labels of less than 9 px, plots of a pair that are stacked in a column beside another column, and a tile
or picture alone in the last row. What scrolls inside its box is not beyond the page.
"""
