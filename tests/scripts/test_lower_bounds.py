"""Constraints for pip at the lower bounds of pyproject.toml."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


def test_every_library_has_a_lower_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from lower_bounds import lower_bounds

    found = lower_bounds((SCRIPTS.parent / "pyproject.toml").read_text(encoding="utf-8"))
    assert "cyclopts==4.8" in found
    assert "onnxruntime==1.22" in found
    with pytest.raises(ValueError, match="expected a library with a lower bound, got numpy"):
        lower_bounds('[project]\ndependencies = ["numpy"]\n[project.optional-dependencies]\n')
    sys.modules.pop("lower_bounds", None)


def test_smoke_runs_every_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from smoke import COMMANDS

    from dvrk_cmaes.cli.app import app

    names = {name for name in app if not name.startswith("-")}
    assert {line.split()[0] for line in COMMANDS} >= names
    sys.modules.pop("smoke", None)
