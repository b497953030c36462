"""The times of images: how old they are, which are followed, and when a clock was set and following begins again."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Final

from dvrk_cmaes.joints.interpolation import NANOSECONDS

LONGEST_GAP: Final = 10.0
"""Time, s, between two images beyond which nothing of the first helps with the second."""
_AGREEING: Final = 3  # images in a row whose times continue each other, which show that the clock was set


_DRIFT: Final = 1e-4  # s per s, by which clocks drift apart at most
_PAUSE: Final = 5.0  # s without an image, after which a recording may have been paused


class Ages:
    """How old images are: how much later it is than their time and the least time from an image's stamp to its receipt.

    The clocks of robot and computer may differ, so only changes of the time between stamp and receipt tell. The least
    one is found anew after images did not come for some seconds, as of a recording that was paused.
    """

    def __init__(self) -> None:
        self._least, self._last = 0.0, -inf

    def receive(self, time: int, now: float) -> None:
        """Take in an image of a time, ns, that was received now, s."""
        way, since = now - time / NANOSECONDS, now - self._last
        self._least = way if since > _PAUSE else min(way, self._least + _DRIFT * since)
        self._last = now

    def age(self, time: int, now: float) -> float:
        """Return the age now, s, of the image of a time, ns."""
        return max(now - time / NANOSECONDS - self._least, 0.0)


@dataclass(frozen=True)
class Judgement:
    """Whether an image is followed, whether following begins anew with it, and lines for status and user, or none."""

    used: bool
    restarts: bool = False
    status: str = ""
    line: str = ""


class ImageTimes:
    """Judges images by their times.

    An image is followed if it is later than the last one, by at most `LONGEST_GAP`. One that is not may have a wrong
    time, and is left out; where three in a row continue each other, the clock was set, and following begins anew. The
    user gets one line for what was left out, or for the clock.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._left_out: list[int] = []
        self._agreeing = 0
        self._told = False

    def judge(self, time: int) -> Judgement:
        """Judge the next image by its time, ns."""
        if time <= 0:
            line = f"header.stamp: expected the time of the image, got {time / NANOSECONDS:g} s"
            return Judgement(used=False, status=line, line=line)
        if self._last is None or _continues(self._last, time):
            line = "" if self._told or not self._left_out else self._what_was_left_out()
            self._told |= bool(line)
            return Judgement(used=True, line=line)
        agrees = bool(self._left_out) and _continues(self._left_out[-1], time)
        self._agreeing = self._agreeing + 1 if agrees else 1
        self._left_out = [*self._left_out[-_AGREEING:], time]
        if self._agreeing >= _AGREEING:
            jump = (time - self._last) / NANOSECONDS
            line = f"header.stamp: the time of the images has jumped by {jump:+z.1f} s; following begins anew"
            return Judgement(used=True, restarts=True, line=line)
        status = self._what_was_left_out()
        says = not self._told and len(self._left_out) >= _AGREEING
        self._told |= says
        return Judgement(used=False, status=status, line=status if says else "")

    def follow(self, time: int) -> None:
        """Go on from an image that was followed."""
        self._last, self._left_out, self._agreeing, self._told = time, [], 0, False

    def _what_was_left_out(self) -> str:
        """Describe the time of the first image that was left out since the last one that was followed."""
        assert self._last is not None
        distance = (self._left_out[0] - self._last) / NANOSECONDS
        what = f"{distance:+z.1f} s from the last one" if distance else "at the time of the last one"
        return f"header.stamp: images that are {what} are left out"


def _continues(before: int, time: int) -> bool:
    """Return whether a time, ns, may be that of the image after another one."""
    return 0 < time - before <= LONGEST_GAP * NANOSECONDS
