"""scripts/bench.py stages: the processor time of a frame by stage."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.batch_sessions import make_session
from helpers.places import SCRIPTS


def test_shares_of_stages_add_up(tmp_path: Path) -> None:
    session = make_session(tmp_path / "session", ["a"])
    command = [sys.executable, SCRIPTS / "bench.py", "stages", "--instrument", "lnd", "--sessions", session, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    *stages, whole = json.loads(done.stdout)["estimate, where the processor time goes"]
    names = [row["stage"] for row in stages]
    assert {"search", "refinement, whole size", "evidence of the mask", "rest"} < set(names)
    assert whole["stage"] == "all, 1 frames"
    assert sum(row["ms a frame"] for row in stages) == pytest.approx(whole["ms a frame"])
    assert sum(row["share, %"] for row in stages) == pytest.approx(100)
    assert all(row["ms a frame"] > 0 for row in stages)
