"""Views of a made pose with the terms that a frame has, for tests of terms and refinement."""

from __future__ import annotations

from typing import Any

import numpy as np

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.config import OutlineConfig
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.refine.gauss_newton import Fit, Steps, assess, refine
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.outline_term import OutlineTerm
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Approximation, Term
from dvrk_cmaes.pose.terms.tips_term import terms_of_frame
from dvrk_cmaes.pose.views import FrameView

SPREAD = np.deg2rad([10, 10, 15])


def view_of(
    body: Body,
    camera: Camera,
    mask: np.ndarray,
    view_from_camera: np.ndarray | None = None,
    ignore: np.ndarray | None = None,
    tips: np.ndarray | None = None,
) -> FrameView:
    """Give a view with a mask."""
    place = np.eye(4) if view_from_camera is None else view_from_camera
    evidence = gather_evidence(mask, camera, body.instrument, ignore=ignore, keypoints=tips)
    return FrameView("", evidence, Renderer(body, camera), place)


def view_at(
    body: Body,
    camera: Camera,
    at: Posed,
    view_from_camera: np.ndarray | None = None,
    ignore: np.ndarray | None = None,
    tips: np.ndarray | None = None,
) -> FrameView:
    """Give a view whose mask is the silhouette of a pose."""
    seen = at if view_from_camera is None else at.seen_from(view_from_camera)
    mask = Renderer(body, camera).masks(seen.pose[None], seen.joints[None])[0]
    return view_of(body, camera, mask, view_from_camera, ignore, tips)


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


class Terms:
    """The terms of a frame with some views, at one image size; ``settings`` are of `OutlineConfig`."""

    def __init__(
        self, views: list[FrameView], readings: Readings, shrink: int = 1, *more: Term, **settings: float
    ) -> None:
        self.config = OutlineConfig(**settings)  # type: ignore[arg-type]
        self.shrink = shrink
        self.views = [SizedView(view, blur=self.config.blur, shrink=shrink) for view in views]
        self.coverage = Coverage(self.views, self.config)
        self.others = terms_of_frame(views, readings, self.config, *more)

    def refined(self, *starts: Posed, cauchy: float | None = None) -> list[Fit]:
        coverage = self.coverage if cauchy is None else self.coverage.changed(cauchy=cauchy)
        return refine(coverage, self.others, Posed.stacked(starts), Steps.of(self.config, self.shrink))

    def assessed(self, at: Posed) -> Fit:
        return assess(self.coverage, self.others, at[None])[0]
