"""Worlds with known truth and what commands make of them, made once for all tests of this folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from promises.program import Kept


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Kept:
    """Commands that run once for all tests, also those of the other workers of pytest-xdist."""
    base = tmp_path_factory.getbasetemp()
    base = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "promises"
    base.mkdir(exist_ok=True)
    return Kept(base)


@pytest.fixture
def quick(kept: Kept) -> Path:
    """Settings of a short search."""
    return kept.quick


@pytest.fixture(autouse=True)
def _quickly(tasks_here: None, estimates_shared: None, small_pictures: None) -> None:
    """Let commands that run in the test's process start no others, each of which takes a second to start.

    They also estimate a frame once, in whatever commands it is, and draw small. `test_outputs` and ``scripts/fuzz.py``
    start the program itself, with its processes.
    """
