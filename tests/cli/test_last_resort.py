"""What no command foresees ends in one line too: unexpected exceptions, warnings of libraries, signals at any time."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import warnings

import pytest
from helpers.commands import run_command
from helpers.demo_files import frame

SIGNALLED = """
import os, sys
from dvrk_cmaes.__main__ import main

module, number, *arguments = sys.argv[1:]

class Signals:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), int(number))

sys.meta_path.insert(0, Signals())
sys.argv[1:], os.environ["DVRK_CMAES_CACHE"] = arguments, "off"  # meshes are read
sys.exit(main())
"""
"""Runs a command line that gets a signal when it imports a module."""


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `estimate` warn, and fail in a way that is not foreseen."""

    def fail(*_: object, **__: object) -> None:
        warnings.warn("overflow encountered", RuntimeWarning, stacklevel=1)
        raise KeyError("one\ntwo")

    monkeypatch.setattr("dvrk_cmaes.runs.frame.estimate_views", fail)


@pytest.mark.usefixtures("faulty")
def test_unexpected_exception_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    ran = run_command(capsys, *frame())
    assert ran.code == 1
    assert ran.complaint.startswith("dvrk-cmaes: internal error: KeyError at test_last_resort.py:")
    assert ran.complaint.endswith("; --debug shows where")


@pytest.mark.usefixtures("faulty")
def test_debug_shows_place_and_warnings(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.warns(RuntimeWarning, match="overflow"):
        ran = run_command(capsys, "--debug", *frame())
    assert ran.code == 1
    assert "Traceback" in ran.err
    assert ran.err.splitlines()[-1].startswith("dvrk-cmaes: internal error: KeyError")


def test_long_message_is_cut_in_the_middle(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(run_command(capsys, *frame(frame="9" * 5000)).refusal) < 1000


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    "module", ["cyclopts", "dvrk_cmaes.cli.estimate", "numpy", "cv2", "trimesh", "dvrk_cmaes.runs.frame"]
)
def test_signal_while_modules_are_imported_ends_with_one_line(module: str, number: signal.Signals) -> None:
    arguments = [sys.executable, "-c", SIGNALLED, module, int(number), *frame()]
    done = subprocess.run([*map(str, arguments)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "dvrk-cmaes: interrupted\n")


def test_too_little_memory_is_one_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dvrk_cmaes", *map(str, frame())],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (400_000 * 1024,) * 2),
        capture_output=True,
        text=True,
        check=False,
    )
    line = "dvrk-cmaes: expected a limit of at least 976562 kB of memory, got 400000 kB (ulimit -v)\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", line)
