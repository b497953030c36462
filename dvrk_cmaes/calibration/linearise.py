"""Outlines of a session as functions of its blocks, linearised until the blocks that are estimated are settled.

`linearise` estimates blocks that change what is seen beside a calibration: the outlines are approximated about poses
and blocks, all are estimated, and that is repeated until the blocks stay where they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.consensus import evenly_spaced
from dvrk_cmaes.calibration.frame_fit import OwnEstimate, with_noise
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.lasting_errors import CommonErrors
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, Solved, Solver, marginalise
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.pose.terms.coverage import Coverage
from dvrk_cmaes.pose.terms.shared_errors import LASTING
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.silhouette import Body, OutlinePoints

_SETTLED = 0.25  # standard deviations of the blocks, below which the outlines are not linearised again
PASSES = {"camera": 6, "margin": 5}
"""Largest number of linearisations in which these blocks are estimated."""
SHARED_ERRORS = 1.2
"""Factor on the standard deviations, because the frames of a session share errors of masks and meshes.

In six synthetic sessions of 20 frames with the right camera (three of easy, three of medium masks) the mean squared
distance of the estimate from the truth was 4.0 instead of 3, in its own standard deviations.
"""
NAMED = 2.5
"""Standard deviations from the value of a file, above which one of several unknowns is named."""
_LEAST_EIGENVALUE = 1e-12  # of an information matrix whose diagonal is scaled to 1
_BASE_STD = 1.0, 1.0  # m and rad, of the base beforehand, some of which a session may not determine
FEW, _PAYS = 100, 2  # number of frames that are enough on the way, and the multiple of it from which on that is done


def outline_task(
    body: Body,
    config: EstimateConfig,
    task: tuple[StoredFrame, tuple[int, ...], tuple[ViewAsSeen, ...], Posed, tuple[SeenBlock, ...]],
) -> Quadratic:
    """Compute the outline's terms (1, D + E + S) about a pose, E unknowns of blocks and the S errors that last.

    Other errors that parts of one mask share are eliminated. The noise is that at the frame's own estimate; of several
    views, it is measured at the pose where it is less there: in a wrong rig, no pose fits all views. The task is a
    frame, the numbers of views and how they see, the pose and the blocks.
    """
    frame, numbers, seen, at, blocks = task
    stored = [frame.views[number] for number in numbers]
    views = [one.restored(body, by.camera, by.place) for one, by in zip(stored, seen, strict=True)]
    outline = replace(config.refine.outline, cauchy=config.session.cauchy)
    sized = [SizedView(view, blur=outline.blur, margin=by.margin) for view, by in zip(views, seen, strict=True)]
    own, here = frame.own, Posed.stacked([at])
    if len(views) == 1:
        own = own.of_view(numbers[0])
        own = own if own.residual is not None else with_noise(own, [stored[0].restored(body)], config)
        noises = own.noises
    else:
        pairs = zip(own.noises, OwnEstimate.of(views, at).noises, strict=True)
        noises = tuple(min(pair, key=lambda noise: noise.sigma) for pair in pairs)
    coverage = Coverage(sized, outline, correlations=[noise.length for noise in noises])
    (drawn,) = coverage.draw(here)
    noise = sum(coverage.final_losses(drawn)) if len(views) > 1 or own.residual is None else own.residual
    coverage = coverage.with_noise(noise if own.residual is None else min(noise, own.residual))

    def effects(number: int, points: OutlinePoints, by_pose: Float64) -> Float64:
        size = seen[number].size
        drawn_there = OutlineOfView(views[number].name, sized[number], points, by_pose, at, size)
        return np.column_stack([block.effect(drawn_there) for block in blocks])

    return coverage.near_with_lasting(at, noises, effects, drawn, as_seen=config.session.shadows)


@dataclass(frozen=True, eq=False)
class SessionOutlines:
    """The outlines of N frames in some of their views, as functions of poses, joints and blocks.

    ``stored`` are the frames, ``views`` (N,) the numbers of the views that count; a frame without any does not
    influence the estimate. ``run`` applies a function to many tasks. ``common`` are the errors that the frames share.
    """

    stored: Sequence[StoredFrame]
    views: Sequence[tuple[int, ...]]
    run: Run[Any, Any]
    common: CommonErrors
    blocks: tuple[SeenBlock, ...]

    @property
    def camera(self) -> Camera:
        """The camera of the first frame in its first view that counts, as its file has it."""
        return self.stored[0].views[self.views[0][0] if self.views[0] else 0].evidence.camera

    def near(self, at: Posed, values: Mapping[str, Float64]) -> FrameFits:
        """Linearise the outlines at N poses and values of the blocks by name, in both.

        Raises
        ------
        InputError
            With a changed focal length, the lens distortion is not one-to-one over the image.
        """
        values = {one.name: one.start if one.is_linear else values[one.name] for one in self.blocks}
        tasks = [
            (stored, views, tuple(self._seen(stored, view, values) for view in views), at[k], self.blocks)
            for k, (stored, views) in enumerate(zip(self.stored, self.views, strict=True))
            if views
        ]
        found = iter(self.run(outline_task, tasks))
        size = 6 + at.joints.shape[1] + sum(len(block) for block in values.values())
        terms = [next(found) if views else Quadratic.zero(1, size + LASTING) for views in self.views]
        return FrameFits.with_lasting(at, terms, self.common, values)

    def _seen(self, stored: StoredFrame, number: int, values: Mapping[str, Float64]) -> ViewAsSeen:
        """Return how a view of a frame sees with some values of the blocks."""
        view = stored.views[number]
        camera = view.evidence.camera
        by = ViewAsSeen(camera, view.view_from_camera, 0.0, camera.width / self.camera.width)
        for block in self.blocks:
            by = block.seen(view.name, by, values[block.name])
        return by

    def subset(self, index: Indices) -> SessionOutlines:
        """Return the outlines of the frames at some indices."""
        stored, views = [self.stored[i] for i in index.tolist()], [self.views[i] for i in index.tolist()]
        return replace(self, stored=stored, views=views, common=self.common.subset(index))


@dataclass(frozen=True, eq=False)
class Linearised:
    """A session's ``solution`` with blocks that are seen, from ``fits`` that were linearised near it.

    That was the last of ``passes``. ``at`` are the N poses there. ``covariance`` (K, K) is that of the solution, where
    the base is known to a metre and a radian beforehand.
    ``plausible`` is false if an estimate on the way lay so far away that the outlines said nothing about it. ``first``
    is what the first linearisation told, at the start.
    """

    model: SessionModel
    solution: Solved
    fits: FrameFits
    covariance: Float64
    at: Posed
    passes: int
    plausible: bool
    first: Linearised | None = None

    @property
    def information(self) -> Float64:
        """Information matrix (K, K) of the solution with that of the base beforehand."""
        return self.solution.information + weak(len(self.solution.information))

    def value(self, name: str) -> Float64:
        """Return the values (n,) of a block."""
        return np.asarray(self.solution.calibration.values[name])

    def std(self, block: SeenBlock) -> Float64:
        """Return the standard deviations (n,) of a block."""
        own = np.diag(self.covariance)[self.solution.calibration.place(block.name)]
        return np.hypot(np.sqrt(own), block.least_std)

    def with_std(self, changed: Mapping[str, Float64 | float]) -> tuple[Float64, Float64]:
        """Return what the last linearisation tells if other standard deviations hold beforehand.

        Parameters
        ----------
        changed
            The standard deviations (n,) of some blocks, by name.

        Returns
        -------
        ((K,), (K, K))
            The unknowns as changes, with the values of what is seen, and their covariance.
        """
        calibration, more = self.solution.calibration, np.zeros(len(self.solution.information))
        for name, std in changed.items():
            place = calibration.place(name)
            more[place] = np.square(std) ** -1.0 - np.diag(calibration.information)[place]
        inverse = inverse_information(self.information + np.diag(more))
        values = np.concatenate([np.zeros(calibration.own), calibration.further])
        return values - inverse @ (more * values), self.solution.covariance_of(inverse)


class FramesAt(NamedTuple):
    """N frames about whose poses ``at`` outlines are linearised, with the session's model and its calibration.

    Blocks that the calibration lacks start as `SeenBlock.start` says.
    """

    model: SessionModel
    calibration: Calibration
    at: Posed


def linearise(
    frames: FramesAt, outlines: SessionOutlines, solver: Solver, names: Sequence[str], *, passes: int
) -> Linearised:
    """Estimate blocks beside a calibration, linearising the outlines until those of some names are settled.

    Of many frames, few lead to where the outlines of all are then linearised: frames of a recording that follow each
    other closely err alike, so that what they tell of these grows much more slowly than their number.

    Parameters
    ----------
    frames, outlines
        The frames, and their outlines.
    solver
        What estimates the calibration from linearised outlines.
    names
        Names of the blocks that have to settle.
    passes
        Largest number of linearisations.

    Raises
    ------
    InputError
        As `SessionOutlines.near`.
    """
    (model, calibration, at), first, done = frames, None, 0
    calibration = calibration.beside(*(one for one in outlines.blocks if one.name not in calibration.values))
    index = few_of(len(at)) if passes > 1 else None
    if index is not None:
        of_few = FramesAt(model.subset(index), calibration, at[index])
        few = linearise(of_few, outlines.subset(index), solver, names, passes=passes - 1)
        if few.plausible:
            at = shifted(model, at, calibration, few.solution.calibration)
            calibration, first, done = few.solution.calibration, few.first or few, few.passes
    asked = [one for one in outlines.blocks if one.name in names]
    fits = outlines.near(at, calibration.values)
    while True:
        model, solution = solver(model, fits, calibration)
        calibration, done = solution.calibration, done + 1
        covariance = solution.covariance_of(inverse_information(solution.information + weak(len(solution.information))))
        there = fits.at.moved(marginalise(model, fits, calibration).own)
        plausible = all(one.is_plausible(calibration.values[one.name]) for one in asked)
        last = Linearised(model, solution, fits, covariance, there, done, plausible, first)
        moved = {one: np.abs(last.value(one.name) - fits.seen[one.name]) for one in asked}
        settled = all((most < _SETTLED * last.std(one)).all() for one, most in moved.items())
        if done >= passes or not plausible or settled:
            return last
        first = first or last
        fits = outlines.near(there, calibration.values)


def few_of(count: int) -> Indices | None:
    """Return the indices of a few of ``count`` frames in their order, evenly spaced; None where all are to be used.

    What only leads to a final estimate is found with few frames; the final estimate is always from all of them.

    Parameters
    ----------
    count
        Number of the session's frames.
    """
    return evenly_spaced(count, FEW) if count >= _PAYS * FEW else None


def shifted(model: SessionModel, at: Posed, before: Calibration, after: Calibration) -> Posed:
    """Return N poses that differ from what a calibration predicts as they did from what another one predicts.

    Parameters
    ----------
    model
        The session's model.
    at
        The poses of the N frames.
    before, after
        The calibration that belongs to these poses, and the other one.
    """
    return model.predict(after).moved(at.minus(model.predict(before)))


def inverse_information(information: Float64) -> Float64:
    """Invert an information matrix (K, K), which rounding may have left with negative eigenvalues."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale))


def weak(count: int) -> Float64:
    """Return an information matrix (K, K), K = ``count``, of a base that is hardly known."""
    return np.diag(np.array([_BASE_STD[0] ** -2] * 3 + [_BASE_STD[1] ** -2] * 3 + [0.0] * (count - 6)))
