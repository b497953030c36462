"""Fixtures of the tests of batches, recordings and their files."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from helpers.plain_pictures import plain_pictures


@pytest.fixture(autouse=True, scope="module")
def _plain_pictures() -> Iterator[None]:
    """Let the pages that are written beside results do without pictures."""
    with plain_pictures():
        yield
