"""What a run reads outside the package is found."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.places import ROOT, SCRIPTS


@pytest.mark.usefixtures("scripts_on_path")
def test_paths_outside_of_the_folders_are_named(tmp_path: Path) -> None:
    from check_wheel import outside

    (tmp_path / "linked").symlink_to(tmp_path / "real", target_is_directory=True)
    read = ["/a/b/c", "/a/bc", "/a/b", "/z", "/z", str(tmp_path / "real" / "x")]
    assert outside(read, ["/a/b", str(tmp_path / "linked")]) == ["/a/bc", "/z"]


@pytest.mark.usefixtures("scripts_on_path")
def test_reads_writes_and_processes_are_recorded(tmp_path: Path) -> None:
    from check_wheel import Record

    record = Record()
    record.hook("open", ("read", "r", os.O_RDONLY))
    record.hook("open", (b"own", "w", os.O_WRONLY | os.O_CREAT))
    record.hook("open", ("own", "r", os.O_RDONLY))
    record.hook("open", (3, "r", os.O_RDONLY))
    record.hook("os.listdir", ("folder",))
    record.hook("subprocess.Popen", ("ls", [], None, None))
    assert [os.path.basename(path) for path in record.read] == ["read", "folder"]
    assert record.started == ["subprocess.Popen"]


def test_demo_reads_no_file_outside_the_package(tmp_path: Path) -> None:
    # here the package is that of the checkout; .ci/run does the same with the installed wheel
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    line = [sys.executable, SCRIPTS / "check_wheel.py"]
    ran = subprocess.run(line, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout
    assert "read outside" not in ran.stdout
    assert "5 of 5 frames within the limits" in ran.stdout
    assert "started: " not in ran.stdout
