"""An arm that is followed in a process of its own, so that several arms are followed at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from numpy.typing import NDArray

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.live.follow import FollowedArm

Arrays = Mapping[str, NDArray[Any]] | None
R = TypeVar("R")

_OWN: Final = list["FollowedArm"]()  # the arm that this process follows
_LINES: Final = list[str]()  # of this process for the user, until they are told


class Process(Protocol):
    """An executor with one process."""

    def submit(self, call: Callable[..., R], *arguments: Any) -> Future[R]:
        """Call a function that can be pickled in the process."""

    def kill(self) -> None:
        """Kill the process."""

    def close(self) -> None:
        """Wait until the process has ended."""


class TrackerApart:
    """Follows an arm in another process, as its tracker and what goes on beside it would in this one.

    Parameters
    ----------
    start
        Starts the process, at once and again if it has died.
    make
        Makes, in the process, the arm that is followed there; it can be pickled.
    report
        Takes lines for the user.
    """

    def __init__(self, start: Callable[[], Process], make: Callable[[Report], FollowedArm], report: Report) -> None:
        self.state = ""
        self._start, self._make, self._report = start, make, report
        self._process: Process | None = start()
        self._made = False
        self._readings: list[tuple[float, Mapping[str, float]]] = []

    def begin(self, rig: Rig) -> TrackerApart:
        """Follow anew, by these cameras."""
        if self._process is None:
            self._process, self._made = self._start(), False
        self._readings = []
        self._ask("begin", rig)
        self._made = True
        return self

    def add_readings(self, time: float, joints: Mapping[str, float]) -> None:
        """Keep the readings of one time, s, until the next step."""
        self._readings.append((time, joints))

    def step(self, time: float, mask: Arrays = None, image: Arrays = None, ignore: Arrays = None) -> TrackResult:
        """Follow to the images of a later time, s, as `Tracker.step`."""
        result = self._ask("step", time, mask, image, ignore)
        assert result is not None
        return result

    def after_step(self, time: float) -> None:
        """Begin what is due after the step to a time, s."""
        self._ask("after_step", time)

    def close(self) -> None:
        """End the process, whatever it is at."""
        if self._process is not None:
            self._process.kill()
            self._process.close()

    def _ask(self, name: str, *arguments: Any) -> TrackResult | None:
        """Call a method of the arm in the process, and take what it says; `begin` starts one again that has died."""
        if self._process is None:
            raise DvrkCmaesError("the process of this arm has ended")
        readings, self._readings = self._readings, []
        make = None if self._made else self._make
        try:
            result, self.state, lines = self._process.submit(_called, make, readings, name, arguments).result()
        except Exception:
            if self._lives():
                raise
            self.close()
            self._process = None
            raise DvrkCmaesError("the process of this arm died") from None
        for line in lines:
            self._report(line)
        return result

    def _lives(self) -> bool:
        """Return whether the process answers: what it was asked for may have failed there."""
        try:
            return self._process is not None and self._process.submit(bool).result() is False
        except Exception:
            return False


def _called(
    make: Callable[[Report], FollowedArm] | None,
    readings: Sequence[tuple[float, Mapping[str, float]]],
    name: str,
    arguments: tuple[Any, ...],
) -> tuple[TrackResult | None, str, list[str]]:
    """In the process, make the arm first where that is given, add readings, and call one of its methods.

    Returns the result of a step, None of other methods; how far the arm's base is known, in words; lines for the user.
    """
    if make is not None:
        _OWN[:] = [make(_LINES.append)]
    (own,) = _OWN
    for time, joints in readings:
        try:
            own.add_readings(time, joints)
        except InputError as error:
            _LINES.append(str(error))
    result = getattr(own, name)(*arguments)
    lines = _LINES.copy()
    _LINES.clear()
    return (result if name == "step" else None), own.state, lines
