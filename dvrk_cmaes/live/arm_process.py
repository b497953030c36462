"""An arm that is followed in a process of its own, so that several arms are followed at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
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
        """Call a function, after those before it; the future of a process that has died has ended with its error."""

    def kill(self) -> None:
        """End the process, whatever it is at."""


_here: list[FollowedArm] = []
_lines: list[str] = []
_found: list[Mapping[str, Any]] = []


def _answer(own: ArmSetup | None, *arguments: Any) -> Answer:
    """Follow an arm by other cameras in this process, which follows this arm alone, or do a step of it without one.

    Returns the result, or what was raised, with all else that there is to know.
    """
    from dvrk_cmaes.live.follow import FollowedArm

    if own is not None and not _here:
        _here.append(FollowedArm(replace(own, save=_found.append), _lines.append))
    found: TrackResult | Exception | None = None
    try:
        if own is None:
            found = _here[0].step(*arguments)
        else:
            _here[0].begin(*arguments)
    except Exception as error:
        found = error
    answer = found, _here[0].state, (*_lines,), (*_found,)
    _lines.clear()
    _found.clear()
    return answer


class ArmProcess:
    """Follows an arm in another process, as `FollowedArm` does in this one.

    Parameters
    ----------
    process
        The process. One that has died is started again.
    own
        The arm; each calibration that is found is kept in this process, which has the folder open.
    report
        Takes lines for the user.
    """

    def __init__(self, process: Process, own: ArmSetup, report: Report) -> None:
        self.state = ""
        self._process, self._report, self._save, self._own = process, report, own.save, replace(own, save=None)

    def begin(self, rig: Rig) -> ArmProcess:
        """Follow anew, by these cameras."""
        self._rig = rig
        self._taken(self._process.submit(_answer, self._own, rig))
        return self

    def start_step(self, *arguments: Any) -> Callable[[], Any]:
        """Begin `FollowedArm.step`, with its arguments; returns what waits for the result."""
        return partial(self._taken, self._process.submit(_answer, None, *arguments))

    def close(self) -> None:
        """End the process, whatever it is at."""
        self._process.kill()

    def _taken(self, future: Future[Answer]) -> TrackResult | None:
        """Take an answer of the process; one that has died begins anew."""
        try:
            found, self.state, lines, calibrations = future.result()
        except (BrokenProcessPool, CancelledError):
            self._process.kill()
            self._process.submit(_answer, self._own, self._rig)
            raise DvrkCmaesError("the process of this arm died") from None
        for line in lines:
            self._report(line)
        for document in calibrations:
            if self._save is not None:
                self._save(document)
        if isinstance(found, Exception):
            raise found
        return found
