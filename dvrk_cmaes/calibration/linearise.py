"""Outlines of a session as functions of its blocks, linearised until the blocks that are estimated are settled.

`linearise` estimates blocks that change what is seen, and a calibration: the outlines are approximated about poses
and blocks, all are estimated, and that is repeated until the blocks stay where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import softmax

from dvrk_cmaes.calibration.blocks import Calibration, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.frame_fit import SIDES_IN_SESSION, with_noise
from dvrk_cmaes.calibration.model import CommonErrors, SessionModel
from dvrk_cmaes.calibration.session_frame import Run, StoredFrame
from dvrk_cmaes.calibration.solve import (
    ArmFrames,
    FrameFits,
    Solved,
    inverse_information,
    marginalise,
    solve_with_variances,
)
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.geometry import Float64, Posed, inverse
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.shared_errors import SIDES, without_last
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import Body, OutlinePoints

_STEPS = 10  # largest number of Gauss-Newton steps between two estimates of the variances
_SETTLED = 0.25  # standard deviations of the blocks, below which the outlines are not linearised again
PASSES = 6
"""Largest number of linearisations of the outlines."""


def outline_task(
    body: Body, config: EstimateConfig, task: tuple[StoredFrame, int, ViewAsSeen, Posed, tuple[SeenBlock, ...]]
) -> Quadratic:
    """Compute the outline's terms (1, D + E) about a pose and E unknowns of blocks.

    Errors that parts of one mask share are eliminated. The noise is that at the frame's own estimate. The task is a
    frame, the number of a view and how it sees, the pose and the blocks.
    """
    frame, number, by, at, blocks = task
    view, own = frame.views[number].restored(body, by.camera, by.place), frame.own.of_view(number)
    if own.residual is None:
        own = with_noise(own, [frame.views[number].restored(body)], config)
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    at = _as_large(at, by)
    sized = SizedView(view, blur=outline.blur, margin=by.margin)
    coverage = Coverage([sized], outline, correlations=own.lengths)
    (drawn,) = coverage.draw(Posed.stacked([at]))
    assert own.residual is not None
    coverage = coverage.changed(noise=own.residual)

    def effects(_: int, points: OutlinePoints, by_pose: Float64) -> Float64:
        drawn_there = OutlineOfView(sized, points, at)
        return np.column_stack([block.effect(drawn_there) for block in blocks])

    whole = coverage.near_with_sides(at, own.noises, effects, drawn, as_seen=config.session.shadows)
    left = without_last(whole, np.eye(SIDES) / SIDES_IN_SESSION**2)
    by_scale = np.ones(left.dimension)
    by_scale[:3] /= by.scale
    return Quadratic(left.information * np.outer(by_scale, by_scale), left.slope * by_scale)


def _as_large(at: Posed, by: ViewAsSeen) -> Posed:
    """Return the pose at which the instrument of the model looks as one that is larger by a factor does at a pose."""
    pose = by.place @ at.pose
    pose[:3, 3] /= by.scale
    return Posed(inverse(by.place) @ pose, at.joints)


@dataclass(frozen=True, eq=False)
class ArmOutlines:
    """The outlines of an arm's N frames in one view of each, as functions of poses, joints and blocks.

    They are linearised about the poses ``at`` and the values of the ``calibration``. ``stored`` are the frames,
    ``model`` is that of their readings, ``views`` (N,) are the numbers of the views; a frame without one does not
    influence the estimate. ``run`` applies a function to many tasks. ``common`` are the errors that the frames share.
    ``camera`` is that of the first frame in its view, as its file has it.
    """

    model: SessionModel
    calibration: Calibration
    at: Posed
    stored: Sequence[StoredFrame]
    views: Sequence[int | None]
    run: Run[Any, Any]
    common: CommonErrors
    camera: Camera

    def linearised(self) -> FrameFits:
        """Linearise the outlines in poses, joints and blocks."""
        known = self.calibration.values
        blocks = self.calibration.seen
        values = {one.name: one.start if one.is_linear else known[one.name] for one in blocks}
        tasks = list[tuple[StoredFrame, int, ViewAsSeen, Posed, tuple[SeenBlock, ...]]]()
        for k, (stored, number) in enumerate(zip(self.stored, self.views, strict=True)):
            if number is not None:
                view = stored.views[number]
                by = ViewAsSeen(view.evidence.camera, view.view_from_camera, 0.0)
                for block in blocks:
                    by = block.seen(by, values[block.name])
                tasks.append((stored, number, by, self.at[k], blocks))
        found = iter(self.run(outline_task, tasks))
        size = 6 + self.at.joints.shape[1] + sum(len(block) for block in values.values())
        terms = [Quadratic.zero(1, size) if view is None else next(found) for view in self.views]
        return FrameFits.sharing(self.at, Quadratic.joined(terms), self.common, values)


@dataclass(frozen=True, eq=False)
class Linearised:
    """An arm's part of a ``solution`` with blocks that are seen, from ``fits`` that were linearised near it."""

    model: SessionModel
    solution: Solved
    fits: FrameFits

    @property
    def blocks(self) -> tuple[SeenBlock, ...]:
        """The blocks that are seen."""
        return self.solution.calibration.seen

    @property
    def plausible(self) -> bool:
        """Whether the estimate is near enough for outlines that are linearised there to show the blocks."""
        return all(one.is_plausible(self.value(one.name)) for one in self.blocks)

    @property
    def settled(self) -> bool:
        """Whether the blocks are where they were linearised."""
        std = np.sqrt(np.diag(self.solution.covariance))
        return all(
            one.is_linear
            or (
                np.abs(self.value(one.name) - self.fits.seen[one.name])
                < _SETTLED * np.hypot(std[self.solution.calibration.place(one.name)], one.least_std)
            ).all()
            for one in self.blocks
        )

    def value(self, name: str) -> Float64:
        """Return the values (n,) of a block."""
        return np.asarray(self.solution.calibration.values[name])

    @property
    def at(self) -> Posed:
        """The N poses at the solution."""
        return self.fits.at.moved(marginalise(self.model, self.fits, self.solution.calibration).own)

    def shown_of(self, block: SeenBlock) -> tuple[Float64, Float64]:
        """Return what the frames show of a block without its prior, where others have theirs: (n,) and (n, n).

        These are its values, and their covariance.
        """
        stds = {one.name: one.weak if one.name == block.name else one.known for one in self.blocks}
        calibration, covariance = self.solution.with_std(stds)
        place = calibration.place(block.name)
        return np.asarray(calibration.values[block.name]), covariance[place, place]

    def moved_by(self, block: SeenBlock) -> Float64:
        """Return by how much the calibration is off per unit of a block, (L, n), L unknowns that are predicted."""
        calibration, information = self.solution.calibration, self.solution.information
        own = slice(0, calibration.own)
        return inverse_information(information[own, own]) @ information[own, calibration.place(block.name)]


def linearise(
    arms: Sequence[ArmOutlines],
    config: SessionConfig,
    *,
    passes: int = PASSES,
    first: Sequence[FrameFits] | None = None,
) -> list[Linearised]:
    """Estimate blocks with the calibrations of arms, linearising the outlines until all blocks are settled.

    Parameters
    ----------
    arms
        The frames of each arm, and their outlines.
    config
        Settings of the variance components, which are estimated with the blocks.
    passes
        Largest number of linearisations.
    first
        The first linearisation of each arm, where several estimates begin with the same (`ArmOutlines.linearised`).
    """
    fits = first
    for _ in range(passes):
        fits = [arm.linearised() for arm in arms] if fits is None else fits
        frames = [ArmFrames(arm.model, own, arm.calibration) for arm, own in zip(arms, fits, strict=True)]
        last = list(map(Linearised, *solve_with_variances(frames, config, steps=_STEPS), fits))
        if all(one.settled for one in last) or not all(one.plausible for one in last):
            break
        arms = [
            replace(arm, model=one.model, calibration=one.solution.calibration, at=one.at)
            for one, arm in zip(last, arms, strict=True)
        ]
        fits = None
    return last


def with_prior(alone: Float64, covariance: Float64, std: Float64) -> tuple[Float64, Float64]:
    """Return values (n,) and their covariance (n, n) with normal priors about zero, of standard deviations (n,)."""
    gain = np.diag(std**2) @ np.linalg.inv(covariance + np.diag(std**2))
    return gain @ alone, gain @ covariance


def distance(alone: Float64, covariance: Float64, std: Float64) -> float:
    """Return the squared Mahalanobis distance of values from zero; arguments as of `with_prior`."""
    return float(alone @ np.linalg.solve(covariance + np.diag(std**2), alone))


def with_mixture(
    alone: Float64, covariance: Float64, priors: Sequence[tuple[float, Float64]]
) -> tuple[Float64, Float64]:
    """Return the mean (n,) and mean square (n, n) of values whose prior is a mixture of normal ones about zero.

    ``priors`` are the share of each and its standard deviations (n,).
    """
    each = [with_prior(alone, covariance, std) for _, std in priors]
    whole = [np.linalg.slogdet(covariance + np.diag(std**2))[1] + distance(alone, covariance, std) for _, std in priors]
    weights = softmax(np.log([share for share, _ in priors]) - 0.5 * np.array(whole))
    squares = [spread + np.outer(mean, mean) for mean, spread in each]
    return np.einsum("k,ki->i", weights, [mean for mean, _ in each]), np.einsum("k,kij->ij", weights, squares)
