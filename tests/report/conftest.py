"""Fixtures of the tests of pages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from helpers.browser import chromium, complaints, emulate, requests

if TYPE_CHECKING:
    from selenium.webdriver.remote.webdriver import WebDriver


@pytest.fixture(scope="session")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    """A running headless Chromium, the same for all tests of pages in a process."""
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def page(driver: WebDriver, report: str) -> WebDriver:
    """The page of a test's own ``report``, an address, loaded anew at a width of 1200 px."""
    emulate(driver, width=1200)
    driver.get("about:blank")
    complaints(driver), requests(driver)
    driver.get(report)
    return driver
