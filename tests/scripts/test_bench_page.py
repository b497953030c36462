"""scripts/bench.py page: size and times of a recording's page."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from helpers.commands import Ran


@pytest.mark.browser
def test_report_has_bytes_and_times(run_here: Callable[..., Ran]) -> None:
    done = run_here("bench", "page", "--frames", "60", "--repeats", "1", "--json")
    assert done.code == 0, done.err
    (row,) = done.result["page of a recording"]
    assert (row["frames"], row["pictures"]) == (60, 60)
    assert 0.1 < row["MB"] < 5
    assert row["loaded, s, median"] > 0
    assert row["redrawn, ms, median"] > 0
