"""How far each further view of a rig would turn, if the masks alone decided: a check of the rig's calibration.

At the pose that fits all views together, the distances of one view's contour from the outline tell where that view
would rather have the instrument. A small rotation w of the view about the reference camera moves the instrument in
that view only, so w is a further unknown beside the pose. A wrong baseline looks like a rotation as well: at the
distance z, an error e of the baseline is a rotation by e / z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dvrk_cmaes.camera.rig import turned_place
from dvrk_cmaes.geometry import Float64, Posed, adjoint, inverse
from dvrk_cmaes.pose.refine.elimination import eliminate
from dvrk_cmaes.pose.refine.gauss_newton import Steps, refine
from dvrk_cmaes.pose.refine.information import information_of_views
from dvrk_cmaes.pose.terms.contour import CorrelatedContour, DrawnContour
from dvrk_cmaes.pose.terms.outline_term import Derivatives
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic, Term

Rotation = tuple[Float64, Float64]
"""Rotation (3,), rad, of a view about the reference camera's axes, and its covariance (3, 3)."""

_REACH = 24  # px, in which the contour is searched
_UNKNOWN = np.pi**2  # variance of a rotation, rad^2, where a contour is out of reach
_STEPS = 16
_LIKELY = 2.0  # standard deviations of a rotation, up to which the views may agree ...
_LARGEST_LIKELY = np.deg2rad(0.25)  # ... unless the rotation is larger than this


@dataclass(frozen=True, eq=False)
class PosedInRig(Posed):
    """A pose, and the rotations (..., V - 1, 3), rad, by which the views but the first are turned.

    The rotations are the last 3 (V - 1) of its small changes.
    """

    turns: Float64

    def moved(self, change: Float64) -> PosedInRig:
        """Return where it is after small changes (..., 6 + J + 3 (V - 1)); those of the rotations may be left out."""
        count = 6 + self.joints.shape[-1]
        at, further = Posed(self.pose, self.joints).moved(change[..., :count]), change[..., count:]
        turned = further.reshape(*further.shape[:-1], *self.turns.shape[-2:]) if further.size else 0.0
        return PosedInRig(at.pose, at.joints, self.turns + turned)

    def __getitem__(self, index: Any) -> PosedInRig:
        """Return one or some of the candidates."""
        return PosedInRig(self.pose[index], self.joints[index], self.turns[index])

    @staticmethod
    def stacked(candidates: Any) -> PosedInRig:
        """Return several candidates along a new first axis."""
        parts = [(each.pose, each.joints, each.turns) for each in candidates]
        return PosedInRig(*(np.stack(part) for part in zip(*parts, strict=True)))


class TurnedContours(CorrelatedContour):
    """The contours of the ``views``, of which all but the first may be turned; at poses of type `PosedInRig`."""

    def draw(self, at: Posed, *, derivatives: Derivatives | None = "closed-form") -> list[DrawnContour]:
        """Draw C poses in the turned views."""
        assert isinstance(at, PosedInRig)
        return [self._drawn(at[k]) for k in range(len(at))]

    def _drawn(self, at: PosedInRig) -> DrawnContour:
        """Draw one pose in the turned views, and add up their terms about it and about the turns."""
        own = 6 + len(at.joints)
        count, turned = own + at.turns.size, _by_rotation(at)
        views = [self.views[0], *_turned(self.views[1:], at)]
        information, slope, cost = np.zeros((count, count)), np.zeros(count), 0.0
        for k, (drawn,) in enumerate(CorrelatedContour(views, reach=_REACH).of_views(Posed.stacked([at]))):
            columns = np.eye(own, count)
            if k > 0:
                columns[:, own + 3 * (k - 1) : own + 3 * k] = turned
            information += columns.T @ drawn.information @ columns
            slope += columns.T @ drawn.slope
            cost += drawn.cost
        return DrawnContour(information, slope, cost)


def rotations_of_views(
    views: Sequence[SizedView], terms: Sequence[Term], at: Posed, informations: Sequence[Float64]
) -> list[Rotation]:
    """Fit the rotation of each view but the first together with the pose.

    ``informations`` (6 + J, 6 + J) are those of the views at the pose, as by `information_of_views`. One step suffices
    for views that agree within the errors. Others are turned and fitted further, because the errors of the contours can
    only be told from the disagreement of the views once that is removed.
    """
    if len(views) == 1:
        return []
    contours = TurnedContours(views, reach=_REACH)
    start = PosedInRig(at.pose, at.joints, np.zeros((len(views) - 1, 3)))
    if not all(of_view.information.any() for (of_view,) in contours.of_views(Posed.stacked([at]))):
        return [(np.zeros(3), _UNKNOWN * np.eye(3))] * (len(views) - 1)
    steps = Steps(1, tested="none")
    turned = _refined(contours, terms, start, steps)
    rotations = _with_covariances(turned, at, informations)
    if not any(_disagrees(*rotation) for rotation in rotations):
        return rotations
    turned = _refined(contours, terms, turned, replace(steps, iterations=_STEPS))
    further = _turned(views[1:], turned)
    settled = Posed(turned.pose, turned.joints)
    return _with_covariances(turned, settled, information_of_views([views[0], *further], terms, settled))


def _turned(views: Sequence[SizedView], at: PosedInRig) -> list[SizedView]:
    """Return the views but the first as they are turned."""
    pairs = zip(views, at.turns, strict=True)
    return [view.placed(turned_place(view.view.view_from_camera, turn)) for view, turn in pairs]


def _refined(contours: TurnedContours, terms: Sequence[Term], start: PosedInRig, steps: Steps) -> PosedInRig:
    """Refine a pose together with the rotations of the views."""
    (fit,) = refine(contours, terms, PosedInRig.stacked([start]), steps)
    assert isinstance(fit.at, PosedInRig)
    return fit.at


def _with_covariances(turned: PosedInRig, at: Posed, informations: Sequence[Float64]) -> list[Rotation]:
    """Return the rotations with their covariances, given the information of each view about the pose ``at``."""
    by_rotation = _by_rotation(at)
    found = []
    for k, turn in enumerate(turned.turns, start=1):
        about = _about_rotation(informations, k, by_rotation)
        told = np.trace(about) > 0  # not where a view was turned so far that its contour is out of reach
        found.append((turn, np.asarray(np.linalg.inv(about)) if told else _UNKNOWN * np.eye(3)))
    return found


def _by_rotation(at: Posed) -> Float64:
    """Return the small changes (6 + J, 3) of one pose in a view by a rotation of the view."""
    columns = np.zeros((6 + len(at.joints), 3))
    columns[:6] = adjoint(inverse(at.pose))[:, 3:]
    return columns


def _about_rotation(informations: Sequence[Float64], view: int, by_rotation: Float64) -> Float64:
    """Return the information (3, 3) about the rotation of one view, with the pose eliminated."""
    of_view, whole = informations[view], np.sum(informations, axis=0)
    diagonal = np.diag(whole)
    whole = whole + np.diag(1e-9 * diagonal + 1e-12 * max(float(diagonal.max()), 1.0))  # of joints that nothing tells
    cross = of_view @ by_rotation
    both = Quadratic.zero(1, len(whole) + 3)
    both.information[0] = np.block([[whole, cross], [cross.T, by_rotation.T @ cross]])
    nothing = np.zeros((1, len(whole)))
    left = eliminate(both, nothing, np.zeros((1, *whole.shape)), np.zeros(3)).left
    reduced = left.information[0, len(whole) :, len(whole) :]
    return np.asarray(reduced + 1e-6 * np.trace(reduced) * np.eye(3))


def _disagrees(rotation: Float64, covariance: Float64) -> bool:
    """Return whether a rotation (3,), rad, with its covariance is larger than the errors of the contours explain."""
    significance = float(np.sqrt(rotation @ np.linalg.solve(covariance, rotation)))
    return significance > _LIKELY or float(np.linalg.norm(rotation)) > _LARGEST_LIKELY
