"""Both eyes of a stereo endoscope: two recordings of one time, whose images are paired."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from typing import Final

from dvrk_cmaes.camera.files import Side
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.recording.recording import RecordedImage, Recording

_FARTHEST: Final = NANOSECONDS // 100  # ns, between the images of a pair: less than half of the time between images


@contextmanager
def both_eyes(open_eye: Callable[[Side], AbstractContextManager[Recording]]) -> Iterator[Recording]:
    """Open the recordings of both eyes, the right one as ``right`` of the left one; errors as ``open_eye``."""
    with open_eye("left") as left, open_eye("right") as right:
        of_right = tuple(f"right eye: {note}" for note in right.notes if note.startswith(("images:", "camera:")))
        yield replace(left, right=right, notes=(*left.notes, *of_right))


@dataclass
class Pairing:
    """Pairs images of the right eye with those of the left one, and summarises how far apart they are.

    ``without`` counts the images without a partner, ``farthest`` is the largest distance in time within a pair, ns.
    """

    images: Iterator[RecordedImage]
    without: int = 0
    farthest: int = 0
    _next: RecordedImage | None = None

    def partner(self, time: int) -> RecordedImage | None:
        """Return the image of the right eye taken at a time, ns; None if there is none within 10 ms.

        The times of successive calls must increase.
        """
        while self._next is None or self._next.time < time - _FARTHEST:
            self._next = next(self.images, None)
            if self._next is None:
                break
        if self._next is None or self._next.time > time + _FARTHEST:
            self.without += 1
            return None
        image, self._next = self._next, None
        self.farthest = max(self.farthest, abs(image.time - time))
        return image
