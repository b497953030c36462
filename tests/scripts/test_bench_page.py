"""scripts/bench.py page: size and times of a recording's page."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from helpers.places import SCRIPTS


@pytest.mark.browser
def test_report_has_bytes_and_times() -> None:
    command = [sys.executable, SCRIPTS / "bench.py", "page", "--frames", "60", "--repeats", "1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["page of a recording"]
    assert (row["frames"], row["pictures"]) == (60, 60)
    assert 0.1 < row["MB"] < 5
    assert row["loaded, s, median"] > 0
    assert row["redrawn, ms, median"] > 0
