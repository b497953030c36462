"""Messages about arguments: what is missing, what has no value, and what does not exist is said first."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import run_command


def test_missing_recording_is_named_before_missing_library(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    original = builtins.__import__

    def without_rosbags(name: str, *more: Any, **named: Any) -> Any:
        if name.startswith("rosbags"):
            raise ImportError(name)
        return original(name, *more, **named)

    monkeypatch.setattr(builtins, "__import__", without_rosbags)
    nothere = tmp_path / "nothere.bag"
    refusal = run_command(capsys, "import", nothere, "--out", tmp_path / "out").refusal
    assert refusal == f"{nothere}: no such file; expected a ROS recording"
