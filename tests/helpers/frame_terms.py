"""Views of a made pose, and what terms of it have, for tests of terms and doubts."""

from __future__ import annotations

from typing import Any

import numpy as np

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.terms.sized_view import OutlineTerm
from dvrk_cmaes.pose.terms.term import Approximation, Term
from dvrk_cmaes.pose.views import FrameView

SPREAD = np.deg2rad([10, 10, 15])


def view_at(
    body: Body,
    camera: Camera,
    at: Posed,
    view_from_camera: np.ndarray | None = None,
    tips: np.ndarray | None = None,
) -> FrameView:
    """Give a view whose mask is the silhouette of a pose."""
    place = np.eye(4) if view_from_camera is None else view_from_camera
    seen, renderer = at.seen_from(place), Renderer(body, camera)
    mask = renderer.masks(seen.pose[None], seen.joints[None])[0]
    return FrameView("", gather_evidence(mask, camera, body.instrument, keypoints=tips), renderer, place)


def readings_of(body: Body, values: np.ndarray) -> Readings:
    low, high = body.instrument.limits.T.copy()
    return Readings(values, SPREAD, low, high)


def cost_of(term: Term | OutlineTerm[Any], at: Posed) -> np.ndarray:
    """Give the sum of squares (C,) of a term at C poses."""
    if isinstance(term, Term):
        return term.cost(at)
    return np.array([term.cost_of(drawn) for drawn in term.draw(at, derivatives=None)])


def local_of(term: Term | OutlineTerm[Any], at: Posed) -> Approximation:
    """Give the approximation of half the sum of squares of a term near C poses."""
    return term.local(at) if isinstance(term, Term) else term.near(term.draw(at), at)
