"""An arm that is followed in a process of its own, so that several arms are followed at once."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.live.follow import FollowedArm

Answer = tuple[TrackResult | Exception | None, str, tuple[str, ...]]
"""The result of a step, or what was raised, how far the base is known, and lines for the user."""


class Process(AbstractContextManager[Any], Protocol):
    """A process that calls functions one after the other; after it was killed, the next call starts it again."""

    def submit(self, call: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        """Call a function, after those before it; BrokenProcessPool if the process has died."""

    def kill(self) -> None:
        """End the process, whatever it is at."""


_here: list[FollowedArm] = []
_lines: list[str] = []


def make_here(make: Callable[[Report], FollowedArm]) -> None:
    """Make the arm that this process follows."""
    _here.append(make(_lines.append))


def _begin(rig: Rig) -> Answer:
    return _answered(lambda: _here[0].begin(rig) and None)


def _step(arguments: tuple[Any, ...]) -> Answer:
    return _answered(lambda: _here[0].step(*arguments))


def _answered(call: Callable[[], TrackResult | None]) -> Answer:
    """Return what a call of the arm of this process returns or raises, its state, and the lines since the last call."""
    found: TrackResult | Exception | None
    try:
        found = call()
    except Exception as error:
        found = error
    lines = tuple(_lines)
    _lines.clear()
    return found, _here[0].state, lines


class ArmProcess:
    """Follows an arm in another process, as `FollowedArm` does in this one.

    Parameters
    ----------
    process
        The process, in which `make_here` was called. One that has died is started again.
    report
        Takes lines for the user.
    """

    def __init__(self, process: Process, report: Report) -> None:
        self.state = ""
        self._process, self._report = process, report

    def begin(self, rig: Rig) -> ArmProcess:
        """Follow anew, by these cameras."""
        self._rig = rig
        self._answer(self._asked(_begin, rig))
        return self

    def start_step(self, *arguments: Any) -> Callable[[], Any]:
        """Begin `FollowedArm.step`, with its arguments; returns what waits for the result."""
        return partial(self._answer, self._asked(_step, arguments))

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._process.kill()

    def _asked(self, call: Callable[[Any], Answer], what: Any) -> Future[Answer]:
        """Call a function in the process; its answer is an error if that has died."""
        with suppress(BrokenProcessPool):
            return self._process.submit(call, what)
        died = Future[Answer]()
        died.set_exception(BrokenProcessPool())
        return died

    def _answer(self, future: Future[Answer]) -> TrackResult | None:
        """Take an answer of the process; one that has died begins anew."""
        try:
            found, self.state, lines = future.result()
        except (BrokenProcessPool, CancelledError):
            self._process.kill()
            self._asked(_begin, self._rig)
            raise DvrkCmaesError("the process of this arm died") from None
        for line in lines:
            self._report(line)
        if isinstance(found, Exception):
            raise found
        return found
