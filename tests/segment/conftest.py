"""A fixture for the tests of segmentation."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from helpers.done_once import segmented_anew


@pytest.fixture(autouse=True, scope="module")
def _anew() -> Iterator[None]:
    """Let these tests segment each image when they ask for it."""
    with segmented_anew():
        yield
