"""Estimation of what the further views of a rig differ in from its file, beside a session's calibration.

Of each further view these are the rotation against the first one, the length of the baseline and the focal length
relative to the first one's. They are further constants of the calibration, as the change of the camera and the margin
of the masks, which are estimated with them: a wrong distance of the instrument looks like a wrong baseline. At one
distance a baseline looks like a rotation about the axis across it, so that it is told only as far as the distances
differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.camera_change import MARGIN_STD, WEAK_PRIOR
from dvrk_cmaes.calibration.frame_fit import PER_VIEW, SeenBy, terms_of_rig
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.session_camera import file_deviations
from dvrk_cmaes.calibration.session_rig import FEWEST, LEAST_STD, ViewRotation, ViewScale, is_turned
from dvrk_cmaes.calibration.solve import FrameFits, Solution, marginalise, solve
from dvrk_cmaes.calibration.stored_frame import StoredFrame, changed
from dvrk_cmaes.camera.rig import ViewChange, turned_place
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.term import Quadratic
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]

_CAMERA = 4  # unknowns of the camera and the common margin, before those of the views
_TURN_STD, _BASELINE_STD, _FOCAL_STD = np.deg2rad(1.0), 0.2, 0.1
_MARGIN_STD = 0.5  # px, of the difference of the margins of two eyes
_PRIOR = np.array([_TURN_STD, _TURN_STD, _TURN_STD, _BASELINE_STD, _FOCAL_STD, _MARGIN_STD])
_PINNED = 1e-3  # standard deviation of what stays as in the file, in those of the prior
_SHARED_ERRORS = 1.2  # factor on standard deviations, as of the camera
_LEAST_SCALE_STD = {3: 0.008, 4: 0.003}  # of baseline and focal length, by their number among the unknowns
_LEAST_SCALE = {3: 0.01, 4: 0.004}  # below which they stay as in the file
_CLEAR = 3.0  # standard deviations
_TOLD = 0.9  # of the prior's standard deviation, below which the session tells an unknown
_Scales = dict[tuple[str, int], ViewScale | None]  # by view and number among its unknowns; None if not told
_PASSES = 4  # largest number of linearisations of the outlines
_FAR = 1.0  # standard deviations of a scale, up to which it is far from contradicting the file
_SETTLED = 0.3  # standard deviations of the unknowns, below which the outlines are not linearised again


@dataclass(frozen=True, eq=False)
class RigTask:
    """Arguments of `rig_task`: the frame's stored evidence, where the instrument is, and by what it is seen."""

    stored: StoredFrame
    at: Posed
    seen: tuple[SeenBy, ...]


def rig_task(body: Body, config: EstimateConfig, task: RigTask) -> Quadratic:
    """Compute the outlines' terms about a frame's pose and what all frames share, as `terms_of_rig`."""
    views = [
        FrameView(
            view.name,
            replace(view.stored.restored(), camera=by.camera),
            Renderer(body, by.camera, threads=1),
            by.place,
        )
        for view, by in zip(task.stored.views, task.seen, strict=True)
    ]
    return terms_of_rig(views, config, task.at, task.stored.own, task.seen)


@dataclass(frozen=True, eq=False)
class RigOutlines:
    """The outlines of N frames in all views, as functions of poses, joints, the camera and what views differ in.

    ``stored`` are the frames; ``used`` (N,) tells which of them count. ``turned`` has the rotations (3,), rad, by which
    their further views are turned against the file, by name.
    """

    stored: Sequence[StoredFrame]
    used: NDArray[np.bool_]
    run: Run[Any, Any]
    turned: Mapping[str, Float64]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the further views that are seen beside the first one in enough of the used frames."""
        counts: dict[str, int] = {}
        for stored, used in zip(self.stored, self.used, strict=True):
            for view in stored.views[1:] if used else ():
                counts[view.name] = counts.get(view.name, 0) + 1
        return tuple(name for name, count in counts.items() if count >= FEWEST)

    def near(self, at: Posed, constants: Float64) -> FrameFits:
        """Linearise the outlines at N poses and values of the constants, in both; InputError as `Camera.changed`."""
        names = self.names
        tasks = [RigTask(stored, at[k], self._seen(stored, constants, names)) for k, stored in enumerate(self.stored)]
        terms = Quadratic.joined(self.run(rig_task, tasks))
        used = self.used.astype(np.float64)
        return FrameFits(at, Quadratic(used[:, None, None] * terms.information, used[:, None] * terms.slope), constants)

    def _seen(self, stored: StoredFrame, constants: Float64, names: Sequence[str]) -> tuple[SeenBy, ...]:
        """Return by what the views of a frame are taken to see it; those without a name in ``names`` as they are."""
        seen, margin = [], float(constants[3])
        for view in stored.views:
            number = names.index(view.name) if view.name in names else None
            camera = view.stored.evidence.camera
            size = camera.width / stored.camera.width
            camera = changed(camera, constants[:3], stored.camera.width)
            if number is None:
                seen.append(SeenBy(camera, view.view_from_camera, margin, None, len(names), size))
                continue
            change, wider = change_of(constants, number)
            camera = camera.changed(float(np.exp(change.focal_length)), (0.0, 0.0))
            place = change.place(self.file_place(view.name, view.view_from_camera))
            seen.append(SeenBy(camera, place, margin + wider, number, len(names), size))
        return tuple(seen)

    def file_place(self, name: str, view_from_camera: Float64) -> Float64:
        """Return the place (4, 4) of a view of the frames in the rig's file."""
        return turned_place(view_from_camera, -np.asarray(self.turned.get(name, np.zeros(3))))

    def further(self, changes: Mapping[str, ViewChange]) -> dict[str, ViewChange]:
        """Return changes against the file as changes against the views of the frames, which are turned already."""
        return {
            name: replace(change, rotation=change.rotation - np.asarray(self.turned.get(name, np.zeros(3))))
            for name, change in changes.items()
        }


def change_of(constants: Float64, number: int) -> tuple[ViewChange, float]:
    """Return the change of a further view against the file among the constants, and by how much its margin is wider."""
    own = constants[_of_view(number)]
    return ViewChange(own[:3], float(own[3]), float(own[4])), float(own[5])


@dataclass(frozen=True, eq=False)
class RigEstimate:
    """What a session tells of the further views of its rig.

    ``views`` states it, ``untold`` describes what is not told; ``changes`` are those by name with which the calibration
    holds, and ``at`` the poses of the N frames with them. ``moved`` is whether they are others than before.
    """

    views: tuple[ViewRotation, ...]
    untold: tuple[str, ...]
    changes: Mapping[str, ViewChange]
    calibration: Calibration
    at: Posed
    moved: bool


def estimate_rig(
    model: SessionModel,
    calibration: Calibration,
    prior: Float64,
    config: SessionConfig,
    at: Posed,
    outlines: RigOutlines,
    stated: Sequence[ViewRotation],
    camera: Float64 | None,
    margin: float,
) -> RigEstimate:
    """Estimate baseline and focal length of each further view, and its rotation where one of them is contradicted.

    Parameters
    ----------
    model, calibration
        The session's model and its calibration.
    prior : (K, K)
        Information matrix of the calibration's prior, as in `solve`.
    config
        Standard deviations of the camera file.
    at
        The poses of the N frames.
    outlines
        The same frames' outlines in all views.
    stated
        The rotations of the views that the frames by themselves tell.
    camera : (3,)
        The change of the camera with which the frames were fitted, None if they were fitted with the file's.
    margin
        The margin that was taken off the masks, px.

    Raises
    ------
    InputError
        With a changed focal length, the lens distortion is not one-to-one over the image.
    """
    names = outlines.names
    deviations = _deviations(config, len(names), refined=camera is not None)
    constants = np.zeros(len(deviations))
    constants[:_CAMERA] = [*(np.zeros(3) if camera is None else camera), margin]
    for number, name in enumerate(names):
        constants[_of_view(number)][:3] = outlines.turned.get(name, 0.0)
    there = replace(calibration, further=constants)
    solution, fits = _estimated(model, there, prior, deviations, at, outlines)
    scales = _scales(solution, len(prior), names)
    untold = tuple(text for each in stated for text in _untold(each, scales))
    linearised = _Linearised(model, fits, prior, deviations)
    solution, free = _with_clear_scales(linearised, solution, scales, names)
    if not free[_are_scales(len(deviations))].any():
        views = tuple(_with_scales(each, scales) for each in stated)
        return RigEstimate(views, untold, {}, calibration, at, moved=False)
    turned: dict[str, dict[str, Any]] = {}
    for number, name in enumerate(names):
        first = len(prior) + _of_view(number).start
        covariance = _SHARED_ERRORS**2 * solution.covariance[first : first + 3, first : first + 3]
        covariance = np.degrees(1.0) ** 2 * covariance + np.diag(LEAST_STD**2)
        rotation = np.degrees(solution.calibration.further[_of_view(number)][:3])
        free[_of_view(number)][:3] = applied = is_turned(rotation, covariance)
        turned[name] = {"rotation_deg": rotation, "std_deg": np.sqrt(np.diag(covariance)), "applied": applied}
    solution = linearised.solved(solution.calibration, free)
    found, std = solution.calibration.further, _std(solution, len(prior))
    views, changes = tuple(_with_scales(each, scales) for each in stated), {}
    for number, name in enumerate(names):
        view = next(each for each in views if each.view == name)
        view = replace(view, **turned[name]).with_values(change_of(found, number)[0], std[_of_view(number)][3:5])
        views = tuple(view if each.view == name else each for each in views)
        changes[name] = view.change
    at = fits.at.moved(marginalise(model, fits, solution.calibration).own)
    return RigEstimate(views, untold, changes, replace(solution.calibration, further=np.zeros(0)), at, moved=True)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The session's model and its frames' outlines near the estimate, with what is known beforehand, as of `solve`."""

    model: SessionModel
    fits: FrameFits
    prior: Float64
    deviations: Float64

    def solved(self, there: Calibration, free: NDArray[np.bool_]) -> Solution:
        """Return the solution where unknowns that are not free are as in the file."""
        start = replace(there, further=np.where(free, there.further, 0.0))
        deviations = np.where(free, self.deviations, _PINNED * self.deviations)
        return solve(self.model, self.fits, start, _padded(self.prior, deviations))


def _with_clear_scales(
    linearised: _Linearised, solution: Solution, scales: _Scales, names: Sequence[str]
) -> tuple[Solution, NDArray[np.bool_]]:
    """Return the solution with those baselines and focal lengths that are clear of the file, and what is free in it.

    What is not clear any more once the others are as in the file stays as there, too; ``scales`` is brought up to date.
    """
    count = len(linearised.prior)
    free = ~_are_scales(len(linearised.deviations))
    clear = {key for key, scale in scales.items() if scale is not None and scale.applied}
    while clear:
        for number, name in enumerate(names):
            for unknown in _LEAST_SCALE_STD:
                free[_of_view(number).start + unknown] = (name, unknown) in clear
        solution = linearised.solved(solution.calibration, free)
        scales |= {key: scale for key, scale in _scales(solution, count, names).items() if key in clear}
        still = {key for key in clear if (scale := scales[key]) is not None and scale.applied}
        if still == clear:
            return solution, free
        clear = still
    return solution, ~_are_scales(len(linearised.deviations))


def _of_view(number: int) -> slice:
    """Return where the unknowns of a further view are among the constants."""
    return slice(_CAMERA + PER_VIEW * number, _CAMERA + PER_VIEW * (number + 1))


def _are_scales(count: int) -> NDArray[np.bool_]:
    """Return which of the constants are baselines and focal lengths."""
    number = np.arange(count) - _CAMERA
    return np.asarray((number >= 0) & np.isin(number % PER_VIEW, list(_LEAST_SCALE_STD)))


def _deviations(config: SessionConfig, views: int, *, refined: bool) -> Float64:
    """Return the standard deviations of all constants beforehand, with V views beside the first one."""
    camera = WEAK_PRIOR if refined else file_deviations(config)
    return np.concatenate([camera, [MARGIN_STD], np.tile(_PRIOR, views)])


def _estimated(
    model: SessionModel,
    there: Calibration,
    prior: Float64,
    deviations: Float64,
    at: Posed,
    outlines: RigOutlines,
) -> tuple[Solution, FrameFits]:
    """Estimate calibration and constants, linearising the outlines until the views' unknowns do not change any more.

    One linearisation suffices where baselines and focal lengths are far from contradicting the file.
    """
    padded = _padded(prior, deviations)
    for _ in range(_PASSES):
        before = there.further
        fits = outlines.near(at, before)
        solution = solve(model, fits, there, padded)
        there = solution.calibration
        std = _std(solution, len(prior))
        settled = (np.abs(there.further - before) < _SETTLED * std)[_CAMERA:].all()
        if settled or not (np.abs(there.further) > _FAR * std)[_are_scales(len(deviations))].any():
            break
        at = at.moved(marginalise(model, fits, there).own)
    return solution, fits


def _padded(prior: Float64, deviations: Float64) -> Float64:
    """Return the information matrix of the calibration's prior and the constants'."""
    count = len(deviations)
    return np.asarray(np.pad(prior, (0, count)) + np.diag([*np.zeros(len(prior)), *deviations**-2]))


def _std(solution: Solution, count: int) -> Float64:
    """Return the standard deviations of the constants, after those of the calibration, which are ``count``."""
    return np.asarray(_SHARED_ERRORS * np.sqrt(np.diag(solution.covariance)[count:]))


def _scales(solution: Solution, count: int, names: Sequence[str]) -> _Scales:
    """Return what is told of the further views' baselines and focal lengths; None where it is not told."""
    found, std = solution.calibration.further, _std(solution, count)
    out: _Scales = {}
    for number, name in enumerate(names):
        for unknown, least in _LEAST_SCALE_STD.items():
            value, own = (float(each[_of_view(number)][unknown]) for each in (found, std))
            own = float(np.hypot(own, least))
            told = own < _TOLD * _PRIOR[unknown]
            clear = abs(value) > max(_CLEAR * own, _LEAST_SCALE[unknown])
            out[name, unknown] = ViewScale(float(np.exp(value)), own, clear) if told else None
    return out


def _with_scales(stated: ViewRotation, scales: _Scales) -> ViewRotation:
    """Return what is stated of a view with its baseline and focal length."""
    baseline, focal_length = (scales.get((stated.view, unknown)) for unknown in _LEAST_SCALE_STD)
    return replace(stated, baseline=baseline, focal_length=focal_length)


def _untold(stated: ViewRotation, scales: _Scales) -> list[str]:
    """Describe what of a view's baseline and focal length is not told."""
    names = dict(zip(_LEAST_SCALE_STD, ("baseline", "relative focal length"), strict=True))
    untold = [name for unknown, name in names.items() if scales.get((stated.view, unknown), stated) is None]
    wide = "its standard deviation is as wide as expected beforehand"
    return [f"{name} of the {stated.view} eye: {wide}" for name in untold]
