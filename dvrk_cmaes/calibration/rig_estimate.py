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
_PINNED = 1e-6  # standard deviation of what stays as in the file, in those of the prior
_SHARED_ERRORS = 1.2  # factor on standard deviations, as of the camera
_LEAST_SCALE_STD = {3: 0.008, 4: 0.003}  # of baseline and focal length, by their number among the unknowns
_LEAST_SCALE = {3: 0.01, 4: 0.004}  # below which they stay as in the file
_CLEAR = 3.0  # standard deviations
_TOLD = 0.9  # of the prior's standard deviation, below which the session tells an unknown
_PASSES = 4  # largest number of linearisations of the outlines
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
    own = constants[_CAMERA + PER_VIEW * number :][:PER_VIEW]
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
        constants[_CAMERA + PER_VIEW * number :][:3] = outlines.turned.get(name, 0.0)
    free, there = np.ones(len(deviations), dtype=np.bool_), replace(calibration, further=constants)
    solution, fits = _estimated(model, there, prior, deviations, at, outlines)
    found, std = solution.calibration.further, _std(solution, len(prior))
    scales = {name: _scales(found, std, number) for number, name in enumerate(names)}
    views = tuple(_with_scales(each, scales.get(each.view, {})) for each in stated)
    untold = tuple(text for each in views for text in _untold(each, scales.get(each.view)))
    for number, name in enumerate(names):
        for unknown, scale in scales[name].items():
            free[_CAMERA + PER_VIEW * number + unknown] = scale is not None and scale.applied
    if not any(scale is not None and scale.applied for of_view in scales.values() for scale in of_view.values()):
        return RigEstimate(views, untold, {}, calibration, at, moved=False)
    solution = _pinned(model, fits, solution.calibration, prior, deviations, free)
    for number, name in enumerate(names):
        own = slice(_CAMERA + PER_VIEW * number, _CAMERA + PER_VIEW * number + 3)
        of_turn = slice(len(prior) + own.start, len(prior) + own.stop)
        covariance = _SHARED_ERRORS**2 * solution.covariance[of_turn, of_turn] + np.diag(np.deg2rad(LEAST_STD) ** 2)
        turn = solution.calibration.further[own]
        turned = is_turned(np.degrees(turn), np.degrees(1) ** 2 * covariance)
        free[own] = turned
        views = tuple(
            replace(
                each, rotation_deg=np.degrees(turn), std_deg=np.degrees(np.sqrt(np.diag(covariance))), applied=turned
            )
            if each.view == name
            else each
            for each in views
        )
    solution = _pinned(model, fits, solution.calibration, prior, deviations, free)
    at = fits.at.moved(marginalise(model, fits, solution.calibration).own)
    found, std = solution.calibration.further, _std(solution, len(prior))
    changes = {}
    for number, name in enumerate(names):
        change, _ = change_of(found, number)
        of_view = next(each for each in views if each.view == name)
        of_view = of_view.with_values(change, std[_CAMERA + PER_VIEW * number :][3:5])
        views = tuple(of_view if each.view == name else each for each in views)
        changes[name] = of_view.change
    return RigEstimate(views, untold, changes, replace(solution.calibration, further=np.zeros(0)), at, moved=True)


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
    """Estimate calibration and constants, linearising the outlines until the views' unknowns do not change any more."""
    padded = _padded(prior, deviations)
    for _ in range(_PASSES):
        before = there.further
        fits = outlines.near(at, before)
        solution = solve(model, fits, there, padded)
        there = solution.calibration
        if (np.abs(there.further - before) < _SETTLED * _std(solution, len(prior)))[_CAMERA:].all():
            break
        at = at.moved(marginalise(model, fits, there).own)
    return solution, fits


def _pinned(
    model: SessionModel,
    fits: FrameFits,
    there: Calibration,
    prior: Float64,
    deviations: Float64,
    free: NDArray[np.bool_],
) -> Solution:
    """Return the solution by the same linearisation where unknowns that are not free are as in the file."""
    start = replace(there, further=np.where(free, there.further, 0.0))
    return solve(model, fits, start, _padded(prior, np.where(free, deviations, _PINNED * deviations)))


def _padded(prior: Float64, deviations: Float64) -> Float64:
    """Return the information matrix of the calibration's prior and the constants'."""
    count = len(deviations)
    return np.asarray(np.pad(prior, (0, count)) + np.diag([*np.zeros(len(prior)), *deviations**-2]))


def _std(solution: Solution, count: int) -> Float64:
    """Return the standard deviations of the constants, after those of the calibration, which are ``count``."""
    return np.asarray(_SHARED_ERRORS * np.sqrt(np.diag(solution.covariance)[count:]))


def _scales(found: Float64, std: Float64, number: int) -> dict[int, ViewScale | None]:
    """Return what is told of baseline and focal length of a further view, by their number; None if it is not told."""
    out: dict[int, ViewScale | None] = {}
    for unknown, least in _LEAST_SCALE_STD.items():
        value, own = (float(each[_CAMERA + PER_VIEW * number + unknown]) for each in (found, std))
        own = float(np.hypot(own, least))
        told = own < _TOLD * _PRIOR[unknown]
        clear = abs(value) > max(_CLEAR * own, _LEAST_SCALE[unknown])
        out[unknown] = ViewScale(float(np.exp(value)), own, clear) if told else None
    return out


def _with_scales(stated: ViewRotation, scales: Mapping[int, ViewScale | None]) -> ViewRotation:
    """Return what is stated of a view with its baseline and focal length."""
    return replace(stated, baseline=scales.get(3), focal_length=scales.get(4))


def _untold(stated: ViewRotation, scales: Mapping[int, ViewScale | None] | None) -> list[str]:
    """Describe what of a view's baseline and focal length is not told."""
    if scales is None:
        return []
    parts = {
        3: f"baseline of the {stated.view} eye",
        4: f"focal length of the {stated.view} eye beside the first one's",
    }
    untold = [text for unknown, text in parts.items() if scales.get(unknown) is None]
    return [f"{text}: its standard deviation is as wide as expected beforehand" for text in untold]
