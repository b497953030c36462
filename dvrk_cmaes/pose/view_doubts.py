"""Reasons for which the pose of a frame with several views is doubtful."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.doubts import doubts_of_fit, doubts_of_modes
from dvrk_cmaes.pose.refine.outline import OutlineFit
from dvrk_cmaes.pose.search.modes import HasPose
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.results.result import ExpectedError, Quality, ViewCheck


def judge_views(
    modes: Sequence[OutlineFit],
    views: Sequence[FrameView],
    checks: Sequence[ViewCheck],
    expected: ExpectedError,
    probability: float,
    readings: Readings,
    instrument: Instrument,
    trust: TrustConfig,
) -> tuple[list[str], list[str]]:
    """List the reasons, in words, for which the first of all modes is doubtful, and remarks on single views.

    What one view shows well is not in doubt because another view is occluded, cut or has the tips outside: a reason
    that does not hold in every view is a remark that names the view. ``checks`` are those of the views, in their order.
    """
    reasons, remarks = doubts_in_views(
        modes[0], views, [check.quality for check in checks], expected, instrument, trust
    )
    reasons += [text for check in checks[1:] if (text := _disagreement(check, views[0].name, trust)) is not None]
    evidence = next((view.evidence for view in views if view.evidence.shaft_edges), views[0].evidence)
    return reasons + doubts_of_modes(modes, probability, evidence, readings, instrument, trust), remarks


def doubts_in_views(
    fit: HasPose,
    views: Sequence[FrameView],
    qualities: Sequence[Quality],
    expected: ExpectedError,
    instrument: Instrument,
    trust: TrustConfig,
) -> tuple[list[str], list[str]]:
    """List the reasons for which a fit is doubtful that hold in every view, and remarks for those that do not.

    ``qualities`` are those of the fit in each view, in their order.
    """
    of_views = []
    for view, quality in zip(views, qualities, strict=True):
        of_views.append(doubts_of_fit(view.sees(fit), quality, expected, view.evidence, instrument, trust))
    kinds = [{_kind(reason) for reason in reasons} for reasons in of_views]
    everywhere = set.intersection(*kinds)
    reasons = [reason for reason in of_views[0] if _kind(reason) in everywhere]
    remarks = [
        f"view {view.name}: {reason}"
        for view, own in zip(views, of_views, strict=True)
        for reason in own
        if _kind(reason) not in everywhere
    ]
    return reasons, remarks


def _kind(reason: str) -> str:
    """Return the kind of a reason: its text before the first colon."""
    return reason.split(":")[0]


def _disagreement(check: ViewCheck, main: str, trust: TrustConfig) -> str | None:
    """Say by how much a view contradicts the main one; None if it does not, beyond its error."""
    angle = float(np.linalg.norm(check.rotation_deg))
    if angle < trust.largest_view_deg or check.significance < trust.largest_view_sigmas:
        return None
    return (
        f"views disagree: {check.name} fits {main} only if turned by {angle:.2f} deg; the rig may be calibrated "
        "wrongly, or the images are not of one time or exchanged"
    )
