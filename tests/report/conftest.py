"""Fixtures of the tests of pages."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from helpers.browser import chromium
from selenium.webdriver.remote.webdriver import WebDriver


@pytest.fixture(scope="session")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    """A running headless Chromium, the same for all tests of pages in a process."""
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started
