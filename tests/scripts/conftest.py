"""Fixtures of the scripts' tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from helpers.places import SCRIPTS

from dvrk_cmaes.io.bundled import bundled_path

if TYPE_CHECKING:
    from measure.cases import Case


@pytest.fixture
def scripts_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let tests import the scripts' modules."""
    monkeypatch.syspath_prepend(str(SCRIPTS))


@pytest.fixture
def cases(scripts_on_path: None) -> list[Case]:
    """The bundled session's frames as scripts/accuracy.py reads them."""
    from measure.cases import Measurement

    return Measurement([str(bundled_path("demo"))]).cases()
