"""How far each further view of a rig would turn, if the masks alone decided: a check of the rig's calibration.

At the pose that fits all views together, the distances of one view's contour from the outline show where that view
alone would have the instrument. A small rotation w of the view about the reference camera moves the instrument in
that view only, so w is a further unknown beside the pose. A wrong baseline looks like a rotation as well: at the
distance z, an error e of the baseline is a rotation by e / z.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.camera.rig import turned_place
from dvrk_cmaes.geometry import Float64, Posed, adjoint, inverse
from dvrk_cmaes.pose.refine.information import eliminate, information_of_views
from dvrk_cmaes.pose.terms.contour import contour_errors
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term, sum_of_locals

Rotation = tuple[Float64, Float64]
"""Rotation (3,), rad, of a view about the reference camera's axes, and its covariance (3, 3)."""

_REACH = 24  # px, in which the contour is searched
_UNKNOWN = np.pi**2  # variance of a rotation, rad^2, where a contour is out of reach
_STEPS = 16
_TOLERANCE = 0.05  # length of a step, in standard deviations per parameter, below which a fit stops
_LIKELY = 2.0  # standard deviations of a rotation, up to which the views may agree ...
_LARGEST_LIKELY = np.deg2rad(0.25)  # ... unless the rotation is larger than this


def rotations_of_views(
    views: Sequence[SizedView], terms: Sequence[Term], at: Posed, informations: Sequence[Float64]
) -> list[Rotation]:
    """Fit the rotation of each view but the first together with the pose.

    ``informations`` (6 + J, 6 + J) are those of the views at the pose, as by `information_of_views`. One step suffices
    for views that agree within the errors. Others are turned and fitted further, because the errors of the contours can
    only be found from the disagreement of the views once that is removed.
    """
    if len(views) == 1:
        return []
    turns = np.zeros((len(views) - 1, 3))
    if not all(information.any() for information, _, _ in _contours(views, turns, at)):
        return [(turn, _UNKNOWN * np.eye(3)) for turn in turns]
    settled, turns = _fitted(views, terms, at, turns, 1)
    rotations = _with_covariances(turns, at, informations)
    if not any(_disagrees(*rotation) for rotation in rotations):
        return rotations
    settled, turns = _fitted(views, terms, settled, turns, _STEPS)
    return _with_covariances(turns, settled, information_of_views(_placed(views, turns), terms, settled))


def _placed(views: Sequence[SizedView], turns: Float64) -> list[SizedView]:
    """Return the views, of which all but the first are turned."""
    pairs = zip(views[1:], turns, strict=True)
    return [views[0], *(view.placed(turned_place(view.view.view_from_camera, turn)) for view, turn in pairs)]


def _contours(views: Sequence[SizedView], turns: Float64, at: Posed) -> list[tuple[Float64, Float64, Float64]]:
    """Compare the outlines of one pose with the contours in the turned views, as `SizedView.contours`."""
    errors = contour_errors(_REACH)
    return [view.contours(at[None], errors) for view in _placed(views, turns)]


def _fitted(
    views: Sequence[SizedView], terms: Sequence[Term], at: Posed, turns: Float64, steps: int
) -> tuple[Posed, Float64]:
    """Fit the rotations of the views but the first together with the pose, by some steps of Gauss-Newton."""
    own = 6 + len(at.joints)
    for _ in range(steps):
        others = sum_of_locals(terms, at[None])
        information, slope = np.zeros((own + turns.size, own + turns.size)), np.zeros(own + turns.size)
        information[:own, :own], slope[:own] = others.information[0], others.slope[0]
        for k, (of_view, slope_of_view, _) in enumerate(_contours(views, turns, at)):
            columns = np.eye(own, own + turns.size)
            if k > 0:
                columns[:, own + 3 * (k - 1) : own + 3 * k] = _by_rotation(at)
            information += columns.T @ of_view[0] @ columns
            slope += columns.T @ slope_of_view[0]
        step = -np.asarray(np.linalg.solve(_invertible(information), slope), dtype=np.float64)
        at, turns = at.moved(step[:own]), turns + step[own:].reshape(-1, 3)
        for term in terms:
            at = term.allowed(at)
        if step @ information @ step < _TOLERANCE**2 * len(step):
            break
    return at, turns


def _with_covariances(turns: Float64, at: Posed, informations: Sequence[Float64]) -> list[Rotation]:
    """Return the rotations with their covariances, given the information of each view about the pose ``at``."""
    by_rotation = _by_rotation(at)
    found = []
    for k, turn in enumerate(turns, start=1):
        about = _about_rotation(informations, k, by_rotation)
        in_reach = np.trace(about) > 0  # not where a view was turned so far that its contour is out of reach
        found.append((turn, np.asarray(np.linalg.inv(about)) if in_reach else _UNKNOWN * np.eye(3)))
    return found


def _by_rotation(at: Posed) -> Float64:
    """Return the small changes (6 + J, 3) of one pose in a view by a rotation of the view."""
    columns = np.zeros((6 + len(at.joints), 3))
    columns[:6] = adjoint(inverse(at.pose))[:, 3:]
    return columns


def _about_rotation(informations: Sequence[Float64], view: int, by_rotation: Float64) -> Float64:
    """Return the information (3, 3) about the rotation of one view, with the pose eliminated."""
    of_view, whole = informations[view], _invertible(np.sum(informations, axis=0))
    cross = of_view @ by_rotation
    both = Quadratic.zero(1, len(whole) + 3)
    both.information[0] = np.block([[whole, cross], [cross.T, by_rotation.T @ cross]])
    nothing = np.zeros((1, len(whole)))
    left = eliminate(both, nothing, np.zeros((1, *whole.shape)), np.zeros(3)).left
    reduced = left.information[0, len(whole) :, len(whole) :]
    return np.asarray(reduced + 1e-6 * np.trace(reduced) * np.eye(3))


def _invertible(information: Float64) -> Float64:
    """Return an information with little added, so that it is invertible where a joint is not observable."""
    diagonal = np.diag(information)
    return np.asarray(information + np.diag(1e-9 * diagonal + 1e-12 * max(float(diagonal.max()), 1.0)))


def _disagrees(rotation: Float64, covariance: Float64) -> bool:
    """Return whether a rotation (3,), rad, with its covariance is larger than the errors of the contours explain."""
    significance = float(np.sqrt(rotation @ np.linalg.solve(covariance, rotation)))
    return significance > _LIKELY or float(np.linalg.norm(rotation)) > _LARGEST_LIKELY
