"""Outlines of a session as functions of its blocks, linearised until the blocks that are estimated are settled.

`linearise` estimates blocks that change what is seen, and a calibration: the outlines are approximated about poses
and blocks, all are estimated, and that is repeated until the blocks stay where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dvrk_cmaes.calibration.blocks import OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.frame_fit import SIDES_IN_SESSION, with_noise
from dvrk_cmaes.calibration.model import CommonErrors
from dvrk_cmaes.calibration.session_frame import StoredFrame
from dvrk_cmaes.calibration.session_problem import Arms, ArmSession
from dvrk_cmaes.calibration.solve import ArmFrames, FrameFits, Solved, solve_with_variances
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64, Posed, inverse
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.shared_errors import SIDES, without_last
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import Body, OutlinePoints

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


def linearised(arm: ArmSession, common: CommonErrors) -> FrameFits:
    """Linearise the outlines of an arm's frames about its poses and calibration, in poses, joints and blocks.

    They are those of one view of each frame; a frame without one does not influence the estimate. ``common`` are the
    errors that the frames share.
    """
    known, blocks = arm.calibration.values, arm.calibration.seen
    values = {one.name: one.start if one.is_linear else known[one.name] for one in blocks}
    tasks = list[tuple[StoredFrame, int, ViewAsSeen, Posed, tuple[SeenBlock, ...]]]()
    for k, (stored, number) in enumerate(zip(arm.stored, arm.shown, strict=True)):
        if number is not None:
            view = stored.views[number]
            by = ViewAsSeen(view.evidence.camera, view.view_from_camera, 0.0)
            for block in blocks:
                by = block.seen(by, values[block.name])
            tasks.append((stored, number, by, arm.at[k], blocks))
    found = iter(arm.setup.run(outline_task, tasks))
    size = 6 + arm.at.joints.shape[1] + sum(len(block) for block in values.values())
    terms = [Quadratic.zero(1, size) if view is None else next(found) for view in arm.shown]
    return FrameFits(arm.at, Quadratic.joined(terms), common, values)


def plausible(arms: Sequence[Solved]) -> bool:
    """Whether estimates are near enough for outlines that are linearised there to show the blocks."""
    return all(block.is_plausible(arm.value(block.name)) for arm in arms for block in arm.calibration.seen)


def _settled(arm: Solved) -> bool:
    """Whether the blocks are where they were linearised."""
    std = np.sqrt(np.diag(arm.covariance))
    return all(
        (
            np.abs(arm.value(one.name) - arm.fits.seen[one.name])
            < _SETTLED * np.hypot(std[arm.calibration.place(one.name)], one.least_std)
        ).all()
        for one in arm.calibration.seen
        if not one.is_linear
    )


def linearise(arms: Arms, *, passes: int = PASSES, first: Sequence[FrameFits] | None = None) -> list[Solved]:
    """Estimate blocks with the calibrations of arms, linearising the outlines until all blocks are settled.

    Parameters
    ----------
    arms
        The arms, whose calibrations have the blocks (`ArmSession.outlined`).
    passes
        Largest number of linearisations.
    first
        The first linearisation of each arm, where several estimates begin with the same (`linearised`).
    """
    fits, common = first, [arm.common for arm in arms]
    for _ in range(passes):
        fits = list(map(linearised, arms, common)) if fits is None else fits
        frames = [ArmFrames(arm.model, own, arm.calibration) for arm, own in zip(arms, fits, strict=True)]
        last = solve_with_variances(frames, arms[0].setup.config.session)
        if all(map(_settled, last)) or not plausible(last):
            break
        arms = [arm.with_solution(one, moved=one.at) for arm, one in zip(arms, last, strict=True)]
        fits = None
    return last
