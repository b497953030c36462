"""Named blocks of unknowns that all frames of a session share, and the outlines as functions of these.

A `Constant` is a change of the camera, the margin of the masks or what a further view of the rig differs in from its
file: what it does to a view, and by how much it displaces the points of an outline there. `linearise` estimates
constants beside a session's calibration: the outlines are approximated about poses and constants, both are estimated,
and that is repeated until the constants stay where they are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.consensus import evenly_spaced
from dvrk_cmaes.calibration.frame_fit import OwnEstimate, with_noise
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.lasting_errors import CommonErrors
from dvrk_cmaes.calibration.model import Calibration, Constants, SessionModel
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

_SETTLED = 0.25  # standard deviations of the constants, below which the outlines are not linearised again
PASSES = {"camera": 6, "margin": 5}
"""Largest number of linearisations in which these constants are estimated."""
SHARED_ERRORS = 1.2
"""Factor on the standard deviations, because the frames of a session share errors of masks and meshes.

In six synthetic sessions of 20 frames with the right camera (three of easy, three of medium masks) the mean squared
distance of the estimate from the truth was 4.0 instead of 3, in its own standard deviations.
"""
CLEAR = 3.0
"""Standard deviations from the value of a file, beyond which a constant differs from it."""
NAMED = 2.5
"""Standard deviations from the value of a file, above which one of several unknowns is named."""
TOLD = 0.9
"""Share of the standard deviation beforehand, below which a session tells an unknown."""
_LEAST_EIGENVALUE = 1e-12  # of an information matrix whose diagonal is scaled to 1
_BASE_STD = 1.0, 1.0  # m and rad, of the base beforehand, some of which a session may not determine
FEW, _PAYS = 100, 2  # number of frames that are enough on the way, and the multiple of it from which on that is done


@dataclass(frozen=True, eq=False)
class ViewAsSeen:
    """How a view is taken to see the instrument: its ``camera``, ``place`` (4, 4), m, and mask's ``margin``, px.

    ``size`` is the width of its images in that of the reference camera's.
    """

    camera: Camera
    place: Float64
    margin: float
    size: float


@dataclass(frozen=True, eq=False)
class OutlineOfView:
    """The N points of the outline of a pose ``at`` in a view, and their displacements ``by_pose`` (N, D), px.

    Displacements are times the lengths of the points' normals. ``name`` is that of the view.
    """

    name: str
    view: SizedView
    points: OutlinePoints
    by_pose: Float64
    at: Posed
    size: float


class Constant(ABC):
    """A block of n unknowns that all frames share: its prior, about zero, and its effect on what a view shows.

    Parameters
    ----------
    name
        Name of the block.
    std : (n,)
        Standard deviations beforehand.
    start : (n,)
        Values from which estimates start; zero by default.
    """

    is_linear: ClassVar[bool] = False
    """Whether the outlines are always linearised where the unknowns are zero."""

    def __init__(self, name: str, std: Float64, start: Float64 | None = None) -> None:
        self.name, self.std = name, std
        self.start = np.zeros(len(std)) if start is None else start

    @property
    def least_std(self) -> Float64:
        """Standard deviations (n,) of errors that the scatter of a session's frames does not show; by default none."""
        return np.zeros(len(self.std))

    def is_plausible(self, values: Float64) -> bool:
        """Whether outlines that are linearised at some values (n,) still tell something; by default at all."""
        return True

    @abstractmethod
    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return how a view of some name sees with the values (n,); InputError as `Camera.changed`."""

    @abstractmethod
    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements (N, n) of the outline's points by the unknowns, times their normals' lengths, px."""


def outline_task(
    body: Body,
    config: EstimateConfig,
    task: tuple[StoredFrame, tuple[int, ...], tuple[ViewAsSeen, ...], Posed, tuple[Constant, ...]],
) -> Quadratic:
    """Compute the outline's terms (1, D + E + S) about a pose, E constants and the S errors that last.

    Other errors that parts of one mask share are eliminated. The noise is that at the frame's own estimate; of several
    views, it is measured at the pose where it is less there: in a wrong rig, no pose fits all views. The task is a
    frame, the numbers of views and by what they are seen, the pose and the constants.
    """
    frame, numbers, seen, at, constants = task
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
        return np.column_stack([constant.effect(drawn_there) for constant in constants])

    return coverage.near_with_lasting(at, noises, effects, drawn, as_seen=config.session.shadows)


@dataclass(frozen=True, eq=False)
class SessionOutlines:
    """The outlines of N frames in some of their views, as functions of poses, joints and constants.

    ``stored`` are the frames, ``views`` (N,) the numbers of the views that count; a frame without any does not
    influence the estimate. ``run`` applies a function to many tasks. ``common`` are the errors that the frames share.
    """

    stored: Sequence[StoredFrame]
    views: Sequence[tuple[int, ...]]
    run: Run[Any, Any]
    common: CommonErrors
    constants: tuple[Constant, ...]

    @property
    def camera(self) -> Camera:
        """The camera of the first frame in its first view that counts, as its file has it."""
        return self.stored[0].views[self.views[0][0] if self.views[0] else 0].evidence.camera

    def near(self, at: Posed, values: Constants) -> FrameFits:
        """Linearise the outlines at N poses and values of the constants, in both.

        Raises
        ------
        InputError
            With a changed focal length, the lens distortion is not one-to-one over the image.
        """
        values = {**values} | {one.name: one.start for one in self.constants if one.is_linear}
        tasks = [
            (stored, views, tuple(self._seen(stored, view, values) for view in views), at[k], self.constants)
            for k, (stored, views) in enumerate(zip(self.stored, self.views, strict=True))
            if views
        ]
        found = iter(self.run(outline_task, tasks))
        size = 6 + at.joints.shape[1] + sum(len(block) for block in values.values())
        terms = [next(found) if views else Quadratic.zero(1, size + LASTING) for views in self.views]
        return FrameFits.with_lasting(at, terms, self.common, values)

    def _seen(self, stored: StoredFrame, number: int, values: Constants) -> ViewAsSeen:
        """Return how a view of a frame sees with some values of the constants."""
        view = stored.views[number]
        camera = view.evidence.camera
        by = ViewAsSeen(camera, view.view_from_camera, 0.0, camera.width / self.camera.width)
        for constant in self.constants:
            by = constant.seen(view.name, by, values[constant.name])
        return by

    def subset(self, index: Indices) -> SessionOutlines:
        """Return the outlines of the frames at some indices."""
        stored, views = [self.stored[i] for i in index.tolist()], [self.views[i] for i in index.tolist()]
        return replace(self, stored=stored, views=views, common=self.common.subset(index))


@dataclass(frozen=True, eq=False)
class Linearised:
    """A session's ``solution`` with constants, from ``fits`` that were linearised near it in the last of ``passes``.

    ``prior`` (K, K) is the information matrix beforehand, with that of the constants. ``at`` are the N poses there.
    ``covariance`` (K, K) is that of the solution, where the base is known to a metre and a radian beforehand.
    ``plausible`` is false if an estimate on the way lay so far away that the outlines said nothing about it. ``first``
    is what the first linearisation told, at the start.
    """

    model: SessionModel
    solution: Solved
    fits: FrameFits
    prior: Float64
    covariance: Float64
    at: Posed
    passes: int
    plausible: bool
    first: Linearised | None = None

    @property
    def information(self) -> Float64:
        """Information matrix (K, K) of the solution with that of the base beforehand."""
        return self.solution.information + weak(len(self.prior))

    def value(self, name: str) -> Float64:
        """Return the values (n,) of a block."""
        return self.solution.calibration.constants[name]

    def std(self, constant: Constant) -> Float64:
        """Return the standard deviations (n,) of a block."""
        own = np.diag(self.covariance)[self.solution.calibration.place(constant.name)]
        return np.hypot(np.sqrt(own), constant.least_std)

    def with_std(self, changed: Mapping[str, Float64 | float]) -> tuple[Float64, Float64]:
        """Return what the last linearisation tells if other standard deviations hold beforehand.

        Parameters
        ----------
        changed
            The standard deviations (n,) of some blocks, by name.

        Returns
        -------
        ((K,), (K, K))
            The calibration's unknowns as changes, with the values of the constants, and their covariance.
        """
        calibration, more = self.solution.calibration, np.zeros(len(self.prior))
        for name, std in changed.items():
            place = calibration.place(name)
            more[place] = np.square(std) ** -1.0 - np.diag(self.prior)[place]
        inverse = inverse_information(self.information + np.diag(more))
        values = np.concatenate([np.zeros(len(self.prior) - len(calibration.further)), calibration.further])
        return values - inverse @ (more * values), self.solution.covariance_of(inverse)


class FramesAt(NamedTuple):
    """N frames about whose poses ``at`` outlines are linearised, with the session's model and its calibration.

    Without constants, those of the calibration start as `Constant.start` says. ``prior`` (K, K) is the information
    matrix of the calibration's prior, as in `solve`, without the constants.
    """

    model: SessionModel
    calibration: Calibration
    prior: Float64
    at: Posed


def linearise(
    frames: FramesAt, outlines: SessionOutlines, solver: Solver, names: Sequence[str], *, passes: int
) -> Linearised:
    """Estimate constants beside a calibration, linearising the outlines until those of some names are settled.

    Of many frames, few lead to where the outlines of all are then linearised: frames of a recording that follow each
    other closely err alike, so that what they tell of constants grows much more slowly than their number.

    Parameters
    ----------
    frames, outlines
        The frames, and their outlines.
    solver
        What estimates calibration and constants from linearised outlines.
    names
        Names of the blocks that have to settle.
    passes
        Largest number of linearisations.

    Raises
    ------
    InputError
        As `SessionOutlines.near`.
    """
    model, calibration, prior, at = frames
    constants, first, done = outlines.constants, None, 0
    if not calibration.constants:
        calibration = replace(calibration, constants={one.name: one.start for one in constants})
    index = few_of(len(at)) if passes > 1 else None
    if index is not None:
        of_few = FramesAt(model.subset(index), calibration, prior, at[index])
        few = linearise(of_few, outlines.subset(index), solver, names, passes=passes - 1)
        if few.plausible:
            at = shifted(model, at, calibration, few.solution.calibration)
            calibration, first, done = few.solution.calibration, few.first or few, few.passes
    padded = np.diag(np.concatenate([np.zeros(len(prior)), *(one.std**-2 for one in constants)]))
    padded[: len(prior), : len(prior)] += prior
    asked = [one for one in constants if one.name in names]
    fits = outlines.near(at, calibration.constants)
    while True:
        model, solution = solver(model, fits, calibration, padded)
        calibration, done = solution.calibration, done + 1
        covariance = solution.covariance_of(inverse_information(solution.information + weak(len(padded))))
        there = fits.at.moved(marginalise(model, fits, calibration).own)
        plausible = all(one.is_plausible(calibration.constants[one.name]) for one in asked)
        last = Linearised(model, solution, fits, padded, covariance, there, done, plausible, first)
        moved = {one: np.abs(last.value(one.name) - fits.constants[one.name]) for one in asked}
        settled = all((most < _SETTLED * last.std(one)).all() for one, most in moved.items())
        if done >= passes or not plausible or settled:
            return last
        first = first or last
        fits = outlines.near(there, calibration.constants)


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
