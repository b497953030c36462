"""A search of one image that goes on in the steps after it, a slice in each, and the images that came meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette.sliced_call import SlicedCall
from dvrk_cmaes.track.hypothesis import Hypothesis
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.recovery import GlobalSearch
from dvrk_cmaes.track.sight import Seen
from dvrk_cmaes.track.update import Fit

Purpose = Literal["first", "lost", "confirm"]

_MOST_IMAGES: Final = 90  # that come during a search, after which it is given up


@dataclass(frozen=True, eq=False)
class SlicedSearch:
    """The search of an image of a ``time``, s, what was known there, and what it is for.

    ``hypotheses`` are the modes as they were predicted for that image or, to be confirmed, followed to it; ``fit`` is
    what supports the first of them there, None if nothing does. ``later`` are the images that have come since, with
    their times.
    """

    call: SlicedCall[Result | None]
    purpose: Purpose
    time: float
    anchor: Anchor
    seen: Seen
    hypotheses: tuple[Hypothesis, ...]
    fit: Fit | None
    later: list[tuple[float, Seen]] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        solve: GlobalSearch,
        purpose: Purpose,
        time: float,
        anchor: Anchor,
        seen: Seen,
        hypotheses: Sequence[Hypothesis],
        fit: Fit | None = None,
    ) -> SlicedSearch:
        """Begin a search."""
        kept = seen.copied()
        call = SlicedCall(lambda: solve(kept, anchor, first=purpose == "first"))
        return cls(call, purpose, time, anchor, kept, tuple(hypotheses), fit)

    def advance(self, work: float) -> bool:
        """Go on by a slice of so many pixel rows; returns whether the search has ended."""
        return self.call.advance(work)

    @property
    def left(self) -> float:
        """Pixel rows of the last slice that were not drawn."""
        return self.call.left

    def add(self, time: float, seen: Seen) -> bool:
        """Keep an image that comes during the search; returns whether there are not too many."""
        self.later.append((time, seen))
        return len(self.later) <= _MOST_IMAGES

    @property
    def reason(self) -> str:
        """What a step says that has no pose yet."""
        doing = self.call.stage or "searching"
        return f"{doing}: the image of {self.time:.3f} s"
