"""An arm that is followed in a process of its own, so that several arms are followed at once.

The process is asked by tuples: readings, then the rig with which following begins anew, or the time, s, and the arrays
of images to follow to. It answers with the result of a step, or what was raised, what is known of the base, and lines
for the user.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.live.follow import FollowedArm

Arrays = Mapping[str, NDArray[Any]] | None
Start = Callable[[Callable[[Connection], None]], tuple[Connection, BaseProcess]]
"""Starts a process that calls a picklable function with its end of a connection; returns the other end."""
_Readings = list[tuple[float, Mapping[str, float]]]
_Images = tuple[float, Arrays, Arrays, Arrays]


def serve(make: Callable[[Report], FollowedArm], connection: Connection) -> None:
    """Follow, in this process, the arm that ``make`` makes, as a connection asks, until that is closed."""
    lines: list[str] = []
    with make(lines.append) as own:
        while True:
            try:
                readings, rig, images = connection.recv()
            except (EOFError, OSError):
                return
            try:
                found = _followed(own, readings, rig, images, lines.append)
            except Exception as error:
                found = error
            connection.send((found, own.state, tuple(lines)))
            lines.clear()
            if images is not None:
                own.after_step(images[0])


def _followed(
    own: FollowedArm, readings: _Readings, rig: Rig | None, images: _Images | None, report: Report
) -> TrackResult | Exception | None:
    """Do what the process is asked for."""
    for time, joints in readings:
        try:
            own.add_readings(time, joints)
        except InputError as error:
            report(str(error))
    if rig is not None:
        own.begin(rig)
    return None if images is None else own.step(*images)


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
        self._readings: _Readings = []

    def begin(self, rig: Rig) -> ArmProcess:
        """Follow anew, by these cameras."""
        self._opened = self._opened or self._start(self._serve)
        self._readings = []
        self._asked(rig, None)()
        return self

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Keep the readings of one time, s, until the next step."""
        self._readings.append((time, joints))

    def start_step(
        self, time: float, mask: Arrays = None, image: Arrays = None, ignore: Arrays = None
    ) -> Callable[[], TrackResult]:
        """Begin to follow to the images of a later time, s; returns what waits for the result."""
        return self._asked(None, (time, mask, image, ignore))

    def after_step(self, time: float) -> None:
        """Do nothing: what is due after a step is begun in the process once it has answered."""

    def close(self) -> None:
        """End the process, whatever it is at."""
        if self._opened is not None:
            (connection, process), self._opened = self._opened, None
            process.kill()
            process.join()
            connection.close()

    def _asked(self, rig: Rig | None, images: _Images | None) -> Callable[[], Any]:
        """Ask the process, if it is there; returns what takes its answer."""
        readings, self._readings = self._readings, []
        if self._opened is not None:
            with suppress(OSError):  # of a process that has died, as the end of its answers tells
                self._opened[0].send((readings, rig, images))
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
