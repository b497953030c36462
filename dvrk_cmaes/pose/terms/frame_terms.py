"""The terms of a frame beside its outline."""

from __future__ import annotations

from collections.abc import Sequence

from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.terms.readings_term import ReadingsTerm
from dvrk_cmaes.pose.terms.term import Term
from dvrk_cmaes.pose.terms.tips_term import TipsTerm
from dvrk_cmaes.pose.views import FrameView


def terms_of_frame(views: Sequence[FrameView], readings: Readings, config: OutlineConfig, *more: Term) -> list[Term]:
    """Return the terms of a frame's readings and given tips, and those of what else is expected of its pose."""
    return [ReadingsTerm(readings), *TipsTerm.of_views(views, config), *more]
