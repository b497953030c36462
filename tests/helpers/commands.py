"""Command lines run in the test's process, with their output."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any

import pytest

_MAIN = next(iter(entry_points(group="console_scripts", name="dvrk-cmaes"))).load()


def main(arguments: Sequence[object]) -> int:
    """Run a command line by the program's entry point, which replaces the handlers of signals; gives the exit code."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["dvrk-cmaes", *map(str, arguments)])
        try:
            return int(_MAIN())
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)


class Ran:
    """Exit code and output of a command."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def complaint(self) -> str:
        """The single line on stderr; stdout must be empty."""
        assert self.out == ""
        assert self.err.startswith("dvrk-cmaes: ")
        assert self.err.count("\n") == 1, self.err
        return self.err.strip()

    @property
    def refusal(self) -> str:
        """The line about wrong usage or input, without the program's name; the exit code must be 2."""
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
