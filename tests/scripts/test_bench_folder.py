"""scripts/bench.py folder: its report of rates and memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from helpers.batch_sessions import QUICK, make_session
from helpers.commands import Ran


def test_report_has_rates_and_memory(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    (tmp_path / "quick.toml").write_text(QUICK)
    session = make_session(tmp_path / "session", ["a", "b"])
    options = ["--session", session, "--instrument", "lnd", "--frames", "4", "--config", tmp_path / "quick.toml"]
    done = run_here("bench", "folder", *options, "--workers", "1", "--json")
    assert done.code == 0, done.err
    (row,) = done.result["a folder"]
    assert (row["workers"], row["frames"], row["failed"], row["times one worker's rate"]) == (1, 4, 0, 1)
    assert 20 < row["worker after 2 frames, MB"] < 2000
    assert row["frames a second"] > 0
