"""Following in steps of bounded work: what takes longer goes on in the steps after it, while images wait.

Images are followed one after the other, and one of them may be searched beside that. Work is measured by what is drawn
(`SlicedCall`), not by the clock: the same images give the same results.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.silhouette.sliced_call import SlicedCall, worked
from dvrk_cmaes.track.describe import without_pose
from dvrk_cmaes.track.following import NOT_FOUND, Following, FollowingState
from dvrk_cmaes.track.hypothesis import Hypothesis
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.sight import Seen
from dvrk_cmaes.track.sliced_search import Purpose, SlicedSearch
from dvrk_cmaes.track.update import Fit

STEP: Final = 10_000.0
"""Pixel rows of silhouettes, or other work that takes as long, after which a step ends; some 40 ms."""
STEP_OF_SEARCH: Final = 6000.0
"""The same beside a search, whose next drawing may be of many poses at once."""
LEAST_SEARCHED, MOST_SEARCHED = 1500.0, 4500.0
"""The least that is done in a step for a search, and the most, which one drawing may overrun."""

_OF_AN_IMAGE = 300  # of work beside its corrections
_MOST_WAITING = 90  # images, of which the oldest are left out then
_FEW_WAITING = 3  # images that wait while another one's search begins, or while where it is can be predicted
_SEARCHED_AROUND = 4  # images that are followed late, one after the other, until no other is searched around


@dataclass(eq=False)
class _Queue:
    """Images that are to be followed, the first of which may have been begun, and the search of an earlier one.

    ``ended`` is a search after which is to be decided how to go on. ``followed`` s is the time of the image that was
    followed last, and ``before`` what was followed to it, while the next one is being followed. ``caught_up`` is
    whether there was a time without waiting images since the pose was found. Nothing here refers to the call that does
    the work, which therefore ends with its owner.
    """

    following: Following
    waiting: deque[tuple[float, Seen]] = field(default_factory=deque)
    search: SlicedSearch | None = None
    ended: SlicedSearch | None = None
    followed: float = 0.0
    before: FollowingState | None = None
    caught_up: bool = True
    _late: int = 0  # images that were searched around since none waited

    @property
    def busy(self) -> bool:
        """Whether an image is being searched, or images wait."""
        return self.search is not None or self.ended is not None or bool(self.waiting)

    @property
    def state(self) -> FollowingState:
        """What was followed to the last image."""
        return self.following.state if self.before is None else self.before

    def add(self, time: float, seen: Seen) -> None:
        """Add an image to be followed, and to those that came during a search."""
        seen = seen.copied()
        for search in (self.search, self.ended):
            if search is not None and not search.add(time, seen):
                self.search = None
        if self.state.hypotheses:
            self.waiting.append((time, seen))
        while len(self.waiting) > _MOST_WAITING:
            del self.waiting[1]

    def begin_search(
        self, purpose: Purpose, time: float, anchor: Anchor, seen: Seen, modes: Sequence[Hypothesis], fit: Fit | None
    ) -> None:
        """Begin to search the image that is being followed, unless another one is, or many wait."""
        if self.search is None and self.ended is None and len(self.waiting) <= 1 + _FEW_WAITING:
            self.search = SlicedSearch.of(self.following.solve, purpose, time, anchor, seen, modes, fit)
            self.search.later.extend(list(self.waiting)[1:])

    def go_on(self) -> TrackResult | None:
        """Decide how to go on after a search, and follow all images that wait; return the last result, if any."""
        result = None
        while self.ended is not None or self.waiting:
            self.before = self.following.state
            if self.ended is not None:
                found = self.following.decided(self.ended)
                if found is not None:
                    self.waiting, self.followed, result = deque(self.ended.later), self.ended.time, found
                    self.caught_up = False
                self.ended = None
            else:
                result = self._follow_first()
            self.before = None
        self.caught_up = True
        return result

    def _follow_first(self) -> TrackResult:
        """Follow the first of the images that wait."""
        following, (time, seen) = self.following, self.waiting[0]
        late = len(self.waiting) > 1
        self._late = self._late if late else 0
        searched = following.searched_around
        worked(_OF_AN_IMAGE, drawn=False)
        try:
            around = not late or self._late < _SEARCHED_AROUND
            elapsed = time - self.followed
            return following.follow(time, elapsed, seen, around=around, search_later=self.begin_search)
        finally:
            self._late += following.searched_around - searched
            self.waiting.popleft()
            self.followed = time


class SlicedFollowing:
    """Follows to one image after the other, each in a step, none of which does much more work than `STEP`.

    Where an image is not done with in its step, the result is its prediction, as lost; or no pose, where many images
    wait or the pose has just been found.
    """

    def __init__(self, following: Following) -> None:
        self._following = following
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._queue = _Queue(self._following)
        self._call: SlicedCall[TrackResult | None] | None = None

    @property
    def searching(self) -> bool:
        """Whether work goes on in the next steps: an image is being searched, or images wait."""
        return self._queue.busy

    @property
    def late(self) -> bool:
        """Whether the last image has not been followed to."""
        return bool(self._queue.waiting)

    @property
    def best(self) -> Hypothesis | None:
        """The mode that is believed, as it was followed last; None before the first pose."""
        hypotheses = self._queue.state.hypotheses
        return hypotheses[0] if hypotheses else None

    def followed_until(self, last: float | None) -> float | None:
        """Return the time, s, of the image that the modes are of; ``last`` is that of the last step."""
        return self._queue.followed if self.late else last

    def checkpoint(self) -> dict[str, Any]:
        """Return the state as plain values, without the images that wait and the search."""
        return self._queue.state.checkpoint()

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        self._begin_anew()
        self._following.restore(saved)

    def forget(self) -> None:
        """Forget what was followed; the next image is solved by itself."""
        self._begin_anew()
        self._following.forget()

    def step(self, time: float, before: float | None, seen: Seen) -> TrackResult:
        """Follow to an image, ``before`` s being the time of the last, as far as the work of a step goes."""
        queue, following = self._queue, self._following
        went_on = queue.busy
        if not went_on and (not following.hypotheses or before is None):
            if seen.problem is not None:
                return without_pose(time, seen.problem)
            queue.begin_search("first", time, following.anchor(time), seen, [], None)
        else:
            if not went_on and before is not None:
                queue.followed = before
            queue.add(time, seen)
        result, left = self._advance(STEP if queue.search is None else STEP_OF_SEARCH)
        search = queue.search
        if search is not None and search.advance(min(max(left, LEAST_SEARCHED), MOST_SEARCHED)):
            queue.search, queue.ended = None, search
            again, _ = self._advance(max(search.left, LEAST_SEARCHED))
            result = result if again is None else again
        if result is None or self._call is not None:
            return self._late_result(time)
        return replace(result, searched=result.searched or went_on or queue.busy)

    def _advance(self, work: float) -> tuple[TrackResult | None, float]:
        """Follow images that wait; return the result once none does, and what is left of the ``work``."""
        queue = self._queue
        if self._call is None:
            if queue.ended is None and not queue.waiting:
                return None, work
            self._call = SlicedCall(queue.go_on)
        call = self._call
        if not call.advance(work):
            return None, 0.0
        self._call = None
        return call.value(), call.left

    def _late_result(self, time: float) -> TrackResult:
        """Return what is known of an image that has not been followed to."""
        queue, best = self._queue, self.best
        search = queue.search or queue.ended
        if best is None:
            return without_pose(time, NOT_FOUND if search is None else search.reason, searched=True)
        behind = len(queue.waiting)
        reason = f"searching: an image of {queue.followed:.3f} s is followed to this one, {behind} behind"
        if behind > _FEW_WAITING or not queue.caught_up:
            return without_pose(time, reason, searched=True)
        predicted = self._following.predicted(best, time, time - queue.followed, reason)
        return replace(predicted, searched=True)
