"""Scores of many random candidates: of all by a coarse mesh in very small images, of the best at the search's size.

The loss is an integral over the silhouette, which hardly depends on the size of the image: it ranks candidates nearly
alike at a third of the size. Of 768 candidates in each of 30 frames, the 26 distinct best ones at the search's size
were among the best 135 in the very small images.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.config import SearchConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.pose.search.objective import Objective

_SHOWING = 0.6  # share of the mask's area that a very small image must show as instrument
_OF_UNREAD = 6  # one candidate without readings for so many others is scored again


@dataclass(frozen=True, eq=False)
class ScreenedPoses:
    """N candidates with their losses (N,), and those without the readings' term (N,).

    ``unread`` (N,) tells whose joints ignore the readings; ``by_image`` is infinite for the others.
    """

    at: Posed
    unread: Bool
    losses: Float64
    by_image: Float64

    @staticmethod
    def by(objective: Objective, at: Posed, unread: Bool) -> ScreenedPoses:
        """Score candidates."""
        terms, weights = objective.terms(at), objective.weights
        losses = terms.total(weights)
        return ScreenedPoses(at, unread, losses, np.where(unread, losses - weights.readings * terms.readings, np.inf))


def screened(coarse: Iterable[Objective], fine: Objective, at: Posed, unread: Bool, most: int) -> ScreenedPoses:
    """Score candidates by each of the ``coarse`` objectives, and those that are among the best by the ``fine`` one.

    The best are ``most``, and a sixth as many of the ``unread`` ones without the readings' term; they stay in order.
    """
    for objective in coarse:
        scored = ScreenedPoses.by(objective, at, unread)
        kept = np.zeros(len(at), dtype=np.bool_)
        kept[np.argsort(scored.losses, kind="stable")[:most]] = True
        kept[np.argsort(scored.by_image, kind="stable")[: most // _OF_UNREAD]] = True
        at, unread = at[np.flatnonzero(kept)], unread[kept]
    return ScreenedPoses.by(fine, at, unread)


def screening_size(evidence: Evidence, size: tuple[int, int], search: SearchConfig) -> tuple[int, int] | None:
    """Return the width and height, px, of the very small images, given the ``size`` of the search's.

    They are less small, or there are none, if not most of the mask would show: where the instrument is about as narrow
    as a pixel, the distances from it mean nothing.
    """
    for divisor in range(search.screen_shrink, 1, -1):
        smaller = max(size[0] // divisor, 1), max(size[1] // divisor, 1)
        shares, weight = evidence.at_size(*smaller)
        most_shows = _SHOWING * (shares * weight).sum() <= np.count_nonzero(shares > 0.5)
        if most_shows and evidence.shows_both(*smaller):
            return smaller
    return None
