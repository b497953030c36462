"""An arm that is followed in a process of its own, so that several arms are followed at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.live.follow import ArmSetup, FollowedArm

Answer = tuple[TrackResult | Exception | None, str, tuple[str, ...], tuple[Mapping[str, Any], ...]]
"""The result of a step, or what was raised, how far the base is known, lines for the user, calibrations to be saved."""


class Process(AbstractContextManager[Any], Protocol):
    """A process that calls functions one after the other; after it was killed, the next call starts it again."""

    def submit(self, call: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        """Call a function, after those before it; BrokenProcessPool if the process has died."""

    def kill(self) -> None:
        """End the process, whatever it is at."""


_here: list[FollowedArm] = []
_lines: list[str] = []
_found: list[Mapping[str, Any]] = []


def make_here(own: ArmSetup) -> None:
    """Make the arm that this process follows."""
    from dvrk_cmaes.live.follow import FollowedArm

    _here.append(FollowedArm(replace(own, save=_found.append), _lines.append))


def _done(asked: Rig | tuple[Any, ...]) -> Answer:
    """Begin anew by other cameras, or do a step with some arguments, in this process."""
    found: TrackResult | Exception | None = None
    try:
        if isinstance(asked, Rig):
            _here[0].begin(asked)
        else:
            found = _here[0].step(*asked)
    except Exception as error:
        found = error
    answer = found, _here[0].state, tuple(_lines), tuple(_found)
    _lines.clear()
    _found.clear()
    return answer


class ArmProcess:
    """Follows an arm in another process, as `FollowedArm` does in this one.

    Parameters
    ----------
    process
        The process, in which `make_here` was called. One that has died is started again.
    report
        Takes lines for the user.
    save
        Keeps each calibration that is found, in this process, which has the folder open.
    """

    def __init__(self, process: Process, report: Report, save: Callable[[Mapping[str, Any]], None] | None) -> None:
        self.state = ""
        self._process, self._report, self._save = process, report, save

    def begin(self, rig: Rig) -> ArmProcess:
        """Follow anew, by these cameras."""
        self._rig = rig
        self._answer(self._asked(rig))
        return self

    def start_step(self, *arguments: Any) -> Callable[[], Any]:
        """Begin `FollowedArm.step`, with its arguments; returns what waits for the result."""
        return partial(self._answer, self._asked(arguments))

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._process.kill()

    def _asked(self, what: Rig | tuple[Any, ...]) -> Future[Answer]:
        """Ask the process; its answer is an error if that has died."""
        with suppress(BrokenProcessPool):
            return self._process.submit(_done, what)
        died = Future[Answer]()
        died.set_exception(BrokenProcessPool())
        return died

    def _answer(self, future: Future[Answer]) -> TrackResult | None:
        """Take an answer of the process; one that has died begins anew."""
        try:
            found, self.state, lines, calibrations = future.result()
        except (BrokenProcessPool, CancelledError):
            self._process.kill()
            self._asked(self._rig)
            raise DvrkCmaesError("the process of this arm died") from None
        for line in lines:
            self._report(line)
        if self._save is not None:
            for document in calibrations:
                self._save(document)
        if isinstance(found, Exception):
            raise found
        return found
