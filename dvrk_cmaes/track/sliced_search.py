"""A search of one image that goes on in the steps after it, a slice in each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette.sliced_call import SlicedCall
from dvrk_cmaes.track.hypothesis import Hypothesis
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.recovery import GlobalSearch
from dvrk_cmaes.track.sight import Seen

Purpose = Literal["first", "lost", "confirm"]

SLICE: Final = 6000.0
"""Pixel rows of silhouettes that are drawn for a search in one step; some 30 ms."""
_LONGEST: Final = 10.0  # s, after which what was found is too old


@dataclass(frozen=True, eq=False)
class SlicedSearch:
    """The search of an image of a ``time``, s, what was known there, and what it is for.

    ``hypotheses`` are the modes as they were followed to that image.
    """

    call: SlicedCall[Result | None]
    purpose: Purpose
    time: float
    anchor: Anchor
    seen: Seen
    hypotheses: tuple[Hypothesis, ...]

    @classmethod
    def of(
        cls,
        solve: GlobalSearch,
        purpose: Purpose,
        time: float,
        anchor: Anchor,
        seen: Seen,
        hypotheses: list[Hypothesis],
    ) -> SlicedSearch:
        """Begin a search."""
        call = SlicedCall(lambda: solve(seen, anchor, first=purpose == "first"))
        return cls(call, purpose, time, anchor, seen, tuple(hypotheses))

    def advance(self) -> bool:
        """Go on by a slice; returns whether the search has ended."""
        return self.call.advance(SLICE)

    def is_late(self, time: float) -> bool:
        """Whether what was found is too old for an image of a time, s."""
        return time - self.time > _LONGEST

    @property
    def reason(self) -> str:
        """What a step says that has no pose yet."""
        return f"searching: the image of {self.time:.3f} s"
