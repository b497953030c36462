"""Fixtures of the scripts' tests."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from typing import TYPE_CHECKING

import pytest
from helpers.commands import Ran
from helpers.places import SCRIPTS

from dvrk_cmaes.io.bundled import bundled_path

if TYPE_CHECKING:
    from measure.cases import Case


@pytest.fixture
def scripts_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let tests import the scripts' modules."""
    monkeypatch.syspath_prepend(str(SCRIPTS))


@pytest.fixture
def cases(scripts_on_path: None) -> list[Case]:
    """The bundled session's frames as scripts/accuracy.py reads them."""
    from measure.cases import Measurement

    return Measurement([str(bundled_path("demo"))]).cases()


@pytest.fixture
def tasks_in_a_thread(scripts_on_path: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the scripts run tasks in a thread of this process, which need not import the package again."""
    from measure import processes

    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "1")  # as the scripts do, but not beyond this test
    monkeypatch.setattr(processes, "ProcessPoolExecutor", lambda *_, **__: ThreadPoolExecutor(1))


@pytest.fixture
def compiled_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let comparisons of checkouts take the packages as they are compiled for the tests, too."""
    monkeypatch.setenv("PYTHONPYCACHEPREFIX", "")  # as if it was not set


@pytest.fixture
def run_here(
    tasks_in_a_thread: None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Ran]:
    """Run a script such as accuracy.py with arguments, in this process."""

    def run(name: str, *arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        code = import_module(name).main()
        printed = capsys.readouterr()
        return Ran(code, printed.out, printed.err)

    return run
