"""scripts/bench.py folder: its report of rates and memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from helpers.batch_sessions import QUICK, make_session
from helpers.places import SCRIPTS


def test_report_has_rates_and_memory(tmp_path: Path) -> None:
    (tmp_path / "quick.toml").write_text(QUICK)
    session = make_session(tmp_path / "session", ["a", "b"])
    options = ["--session", session, "--instrument", "lnd", "--frames", "4", "--config", tmp_path / "quick.toml"]
    done = subprocess.run(
        [sys.executable, SCRIPTS / "bench.py", "folder", *options, "--workers", "1", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["a folder"]
    assert (row["workers"], row["frames"], row["failed"], row["times one worker's rate"]) == (1, 4, 0, 1)
    assert 20 < row["worker after 2 frames, MB"] < 2000
    assert row["frames a second"] > 0
