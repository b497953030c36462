"""scripts/bench.py stages: the processor time of a frame by stage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.batch_sessions import make_session
from helpers.commands import Ran


def test_shares_of_stages_add_up(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    session = make_session(tmp_path / "session", ["a"])
    done = run_here("bench", "stages", "--instrument", "lnd", "--sessions", session, "--json")
    assert done.code == 0, done.err
    *stages, whole = done.result["estimate, where the processor time goes"]
    names = [row["stage"] for row in stages]
    assert {"search", "refinement, whole size", "evidence of the mask", "rest"} < set(names)
    assert whole["stage"] == "all, 1 frames"
    assert sum(row["ms a frame"] for row in stages) == pytest.approx(whole["ms a frame"])
    assert sum(row["share, %"] for row in stages) == pytest.approx(100)
    assert all(row["ms a frame"] > 0 for row in stages)
