"""scripts/bench.py calibrate: the processor time of solving a session together."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from helpers.commands import Ran
from helpers.places import ROOT


def test_stages_add_up(run_here: Callable[..., Ran]) -> None:
    options = ("--instrument", "lnd", "--quick", "--json", "--sessions", ROOT / "data" / "demo")
    done = run_here("bench", "calibrate", *options)
    assert done.code == 0, done.err
    (row,) = done.result["calibrate, processor seconds"]
    assert (row.pop("session"), row.pop("frames")) == ("data/demo", 5)
    whole = row.pop("all, s")
    assert {"lag and consensus", "gathering evidence", "round 1 of 4", "leaving one out"} < set(row)
    assert sum(row.values()) == pytest.approx(whole)
