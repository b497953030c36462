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

    The clocks of robot and computer may differ, so only changes of the time between stamp and receipt count. The least
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
    """Whether an image is followed, whether following begins anew with it, and a line that says why, or is empty."""

    used: bool
    restarts: bool = False
    line: str = ""


class ImageTimes:
    """Judges images by their times.

    An image is followed if it is later than the last one, by at most `LONGEST_GAP`. One that is not may have a wrong
    time, and is left out; where three in a row continue each other, the clock was set, and following begins anew.
    """

    def __init__(self) -> None:
        self._last: int | None = None  # ns, of the last image that was followed
        self._left_out: int | None = None  # ns, of the last one since that was not
        self._agreeing = 0

    def judge(self, time: int) -> Judgement:
        """Judge the next image by its time, ns."""
        if time <= 0:
            line = f"header.stamp: expected the time of the image, got {time / NANOSECONDS:g} s"
            return Judgement(used=False, line=line)
        if self._last is None or _continues(self._last, time):
            return Judgement(used=True)
        agrees = self._left_out is not None and _continues(self._left_out, time)
        self._agreeing, self._left_out = self._agreeing + 1 if agrees else 1, time
        ahead = (time - self._last) / NANOSECONDS
        if self._agreeing >= _AGREEING:
            line = f"header.stamp: the time of the images has jumped by {ahead:+z.1f} s; following begins anew"
            return Judgement(used=True, restarts=True, line=line)
        what = f"{ahead:+z.1f} s from the last one" if ahead else "at the time of the last one"
        return Judgement(used=False, line=f"header.stamp: images that are {what} are left out")

    def follow(self, time: int) -> None:
        """Go on from an image that was followed."""
        self._last, self._left_out, self._agreeing = time, None, 0


def _continues(before: int, time: int) -> bool:
    """Return whether a time, ns, may be that of the image after another one."""
    return 0 < time - before <= LONGEST_GAP * NANOSECONDS
