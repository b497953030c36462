"""Command lines run in tests, and what they printed."""

from __future__ import annotations

import json
from typing import Any

import pytest

from dvrk_cmaes.cli import main


class Ran:
    """What a command printed, and its exit code."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def complaint(self) -> str:
        """The only line on stderr, of a command that printed nothing else."""
        assert self.out == ""
        assert self.err.startswith("dvrk-cmaes: ")
        assert self.err.count("\n") == 1
        return self.err.strip()

    @property
    def refusal(self) -> str:
        """The complaint about wrong usage or input, without the program's name."""
        assert self.code == 2
        return self.complaint.removeprefix("dvrk-cmaes: ")

    @property
    def result(self) -> dict[str, Any]:
        """The JSON on stdout."""
        parsed: dict[str, Any] = json.loads(self.out)
        return parsed


def run_command(capsys: pytest.CaptureFixture[str], *arguments: object) -> Ran:
    """Run a command line."""
    code = main([str(argument) for argument in arguments])
    printed = capsys.readouterr()
    return Ran(code, printed.out, printed.err)
