"""scripts/bench.py calibrate: the processor time of solving a session together."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from helpers.places import ROOT, SCRIPTS


def test_stages_add_up() -> None:
    command = [sys.executable, SCRIPTS / "bench.py", "calibrate", "--instrument", "lnd", "--quick", "--json"]
    done = subprocess.run([*command, "--sessions", ROOT / "data" / "demo"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["calibrate, processor seconds"]
    assert (row.pop("session"), row.pop("frames")) == ("data/demo", 5)
    whole = row.pop("all, s")
    assert {"lag and consensus", "gathering evidence", "round 1 of 4", "leaving one out"} < set(row)
    assert sum(row.values()) == pytest.approx(whole)
