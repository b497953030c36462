"""An arm that is followed in a process of its own, so that several arms are followed at once.

The process is asked by the rig with which following begins anew, or by the arguments of a step. It answers with the
result, or what was raised, what is known of the base, and lines for the user.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.live.follow import FollowedArm

Start = Callable[[Callable[[Connection], None]], tuple[Connection, BaseProcess]]
"""Starts a process that calls a picklable function with its end of a connection; returns the other end."""


def serve(make: Callable[[Report], FollowedArm], connection: Connection) -> None:
    """Follow, in this process, the arm that ``make`` makes, as a connection asks, until that is closed."""
    lines: list[str] = []
    with make(lines.append) as own:
        while True:
            try:
                asked = connection.recv()
            except (EOFError, OSError):
                return
            found: TrackResult | Exception | None = None
            try:
                if isinstance(asked, Rig):
                    own.begin(asked)
                else:
                    found = own.step(*asked)
            except Exception as error:
                found = error
            connection.send((found, own.state, tuple(lines)))
            lines.clear()


class ArmProcess:
    """Follows an arm in another process, as `FollowedArm` does in this one.

    Parameters
    ----------
    start
        Starts the process, at once and again if it has died.
    make
        Makes, in the process, the arm that is followed there; it can be pickled.
    report
        Takes lines for the user.
    """

    def __init__(self, start: Start, make: Callable[[Report], FollowedArm], report: Report) -> None:
        self.state = ""
        self._start, self._serve, self._report = start, partial(serve, make), report
        self._opened: tuple[Connection, BaseProcess] | None = start(self._serve)

    def begin(self, rig: Rig) -> ArmProcess:
        """Follow anew, by these cameras."""
        self._opened = self._opened or self._start(self._serve)
        self._asked(rig)()
        return self

    def start_step(self, *arguments: Any) -> Callable[[], Any]:
        """Begin `FollowedArm.step`, with its arguments; returns what waits for the result."""
        return self._asked(arguments)

    def close(self) -> None:
        """End the process, whatever it is at."""
        if self._opened is not None:
            (connection, process), self._opened = self._opened, None
            process.kill()
            process.join()
            connection.close()

    def _asked(self, what: Any) -> Callable[[], TrackResult | None]:
        """Ask the process, if it is there; returns what takes its answer."""
        if self._opened is not None:
            with suppress(OSError):  # of a process that has died, as the end of its answers tells
                self._opened[0].send(what)
        return self._answer

    def _answer(self) -> TrackResult | None:
        """Take the answer of the process; one that has died is started again by `begin`."""
        if self._opened is None:
            raise DvrkCmaesError("the process of this arm has ended")
        found: TrackResult | Exception | None
        try:
            found, self.state, lines = self._opened[0].recv()
        except (EOFError, OSError):
            self.close()
            raise DvrkCmaesError("the process of this arm died") from None
        for line in lines:
            self._report(line)
        if isinstance(found, Exception):
            raise found
        return found
