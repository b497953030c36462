"""A test that fails is named when it fails, also by processes of pytest-xdist."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.places import TESTS


@pytest.mark.parametrize("processes", ["0", "1"])
def test_a_failed_test_is_named_before_the_summary(processes: str, tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text("def test_wrong():\n    assert False\n\n\ndef test_right():\n    pass\n")
    (tmp_path / "conftest.py").write_text(
        "from helpers.named_failures import NamedFailures\n\n\ndef pytest_configure(config):\n"
        "    if not hasattr(config, 'workerinput'):\n        config.pluginmanager.register(NamedFailures(config))\n"
    )
    line = [sys.executable, "-m", "pytest", "-q", "-p", "xdist.plugin", "-n", processes, "-p", "no:cacheprovider"]
    ran = subprocess.run(
        [*line, "-o", f"pythonpath={TESTS}", str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},  # others take longer to import than the tests to run
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 1
    assert "FAILED test_it.py::test_wrong\n" in ran.stdout.split("= FAILURES =")[0]
