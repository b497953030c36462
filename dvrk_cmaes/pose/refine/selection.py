"""Which of several poses that are refined together are worth further iterations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

_OF_OUTLINE = 1 / 3
"""Difference of the outline's score alone that keeps a pose, as a share of that of the whole score."""


@dataclass(frozen=True)
class Selection:
    """The poses that continue after each iteration of a refinement, the best by their scores.

    They are the best ``share`` of those that continued before, and of these such as are close to the best: within
    ``gap`` of its negative log-likelihood, or within a third of that of the best outline's alone, so that an outline
    may contradict the readings. At least ``least`` continue in any case.
    """

    share: float = 1.0
    gap: float = np.inf
    least: int = 1

    def continuing(self, scores: ArrayLike, outline_scores: ArrayLike, left: float) -> list[int]:
        """Return the indices of the poses that continue, best first, if about ``left`` of them continued before.

        ``scores`` are the negative log-likelihoods, ``outline_scores`` the parts of them that come from the outline.
        """
        whole, outline = np.asarray(scores), np.asarray(outline_scores)
        close = (whole <= whole.min() + self.gap) | (outline <= outline.min() + self.gap * _OF_OUTLINE)
        best = np.argsort(whole, kind="stable")[: max(round(left), self.least)]
        return [int(i) for place, i in enumerate(best) if place < self.least or close[i]]


ALL = Selection()
"""All poses continue until they have settled."""
