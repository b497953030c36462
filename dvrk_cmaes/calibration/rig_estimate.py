"""Estimation of what the further views of a rig differ in from its file, beside a session's calibration.

Of each further view these are the rotation against the first one, the length of the baseline and the focal length
relative to the first one's. They are constants of the calibration, as the change of the camera and the margin of the
masks, which are estimated with them: a wrong distance of the instrument looks like a wrong baseline. At one distance a
baseline looks like a rotation about the axis across it, so that it is told only as far as the distances differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.constants import (
    CLEAR,
    PASSES,
    SHARED_ERRORS,
    TOLD,
    Constant,
    FramesAt,
    Linearised,
    OutlineOfView,
    SessionOutlines,
    ViewAsSeen,
    linearise,
)
from dvrk_cmaes.calibration.model import Calibration
from dvrk_cmaes.calibration.session_rig import LEAST_STD, ViewRotation, ViewScale, is_turned
from dvrk_cmaes.calibration.solve import Solved, marginalise, solve, solve_unchanged
from dvrk_cmaes.camera.rig import ViewChange, turned_place
from dvrk_cmaes.geometry import Bool, Float64, Posed, adjoint, inverse
from dvrk_cmaes.pose.terms.coverage import of_camera, of_margin

_STD = np.array([*[np.deg2rad(1.0)] * 3, 0.2, 0.1, 0.5])  # rad, logarithms, and px by which the margins of eyes differ
_PINNED = 1e-3  # standard deviation of what stays as in the file, in those of the prior
_SCALES = {"baseline": 3, "relative focal length": 4}  # numbers of unknowns
_LEAST_SCALE_STD = {3: 0.008, 4: 0.003}
_LEAST_SCALE = {3: 0.01, 4: 0.004}  # below which they stay as in the file
_Scales = dict[tuple[str, int], ViewScale | None]  # by view and number among its unknowns; None if not told


class ViewDifference(Constant):
    """What a further view differs in from the file of the rig (6,).

    That is its rotation about the first camera's axes, rad, the logarithms of the factors on its baseline and its focal
    length, and by how much its masks' margin, px, is larger.

    Parameters
    ----------
    view
        Name of the view.
    turned : (3,)
        The rotation, rad, by which the view of the frames is turned against the file already.
    """

    def __init__(self, view: str, turned: Float64) -> None:
        super().__init__(view, _STD, np.concatenate([turned, np.zeros(3)]))
        self.turned = turned

    @property
    def least_std(self) -> Float64:
        """Standard deviations (6,) of what the frames of a session have in common."""
        return np.array([*np.deg2rad(LEAST_STD), *_LEAST_SCALE_STD.values(), 0.0])

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return the view, if it is this one, with the lens, the place and the mask that the unknowns say."""
        if name != self.name:
            return by
        change = ViewChange(values[:3], float(values[3]), float(values[4]))
        camera = by.camera.changed(float(np.exp(change.focal_length)), (0.0, 0.0))
        in_file = turned_place(by.place, -self.turned)
        return replace(by, camera=camera, place=change.place(in_file), margin=by.margin + float(values[5]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points in the view, if it is this one."""
        if outline.name != self.name:
            return np.zeros((len(outline.by_pose), len(self.std)))
        at, place = outline.at.pose, outline.view.view_from_camera
        along = np.concatenate([(place[:3, :3] @ at[:3, :3]).T @ place[:3, 3], np.zeros(3)])
        moving = np.column_stack([adjoint(inverse(at))[:, 3:], along])  # small changes of the pose that do the same
        of_lens = of_camera(outline.view, outline.points)[:, 0]
        return np.column_stack([outline.by_pose[:, :6] @ moving, of_lens, of_margin(outline.points)])


@dataclass(frozen=True, eq=False)
class RigEstimate:
    """What a session tells of the further views of its rig.

    ``views`` states it, ``undetermined`` describes what is not told; ``changes`` are those by name with which the
    calibration holds, against the views of the frames, and ``at`` the poses of the N frames with them. ``moved`` is
    whether they are others than before.
    """

    views: tuple[ViewRotation, ...]
    undetermined: tuple[str, ...]
    changes: Mapping[str, ViewChange]
    calibration: Calibration
    at: Posed
    moved: bool


def estimate_rig(frames: FramesAt, outlines: SessionOutlines, stated: Sequence[ViewRotation]) -> RigEstimate:
    """Estimate baseline and focal length of each further view, and its rotation where one of them is contradicted.

    Arguments are as in `linearise`; the ``outlines`` are those of all views, with a `ViewDifference` of each further
    one among their constants. ``stated`` are the rotations of the views that the frames by themselves tell.
    """
    further = [one for one in outlines.constants if isinstance(one, ViewDifference)]
    names = [one.name for one in further]
    there = linearise(frames, outlines, solve_unchanged, names, passes=PASSES["rig"])
    scales = _scales(there.solution, names)
    undetermined = tuple(text for each in stated for text in _undetermined(each, scales))
    solution, free = _with_clear_scales(there, scales, names)
    views = {each.view: _with_scales(each, scales) for each in stated}
    if not any(scale is not None and scale.applied for scale in scales.values()):
        return RigEstimate(tuple(views.values()), undetermined, {}, frames.calibration, frames.at, moved=False)
    turned: dict[str, tuple[Float64, Float64, bool]] = {}
    for name in names:
        own = solution.calibration.place(name)
        angles = slice(own.start, own.start + 3)
        covariance = np.degrees(SHARED_ERRORS) ** 2 * solution.covariance[angles, angles] + np.diag(LEAST_STD**2)
        rotation = np.degrees(solution.calibration.constants[name][:3])
        free[angles] = applied = is_turned(rotation, covariance)
        turned[name] = rotation, np.sqrt(np.diag(covariance)), applied
    solution, changes = _solved(there, solution.calibration, free), {}
    for one in further:
        found, std = solution.calibration.constants[one.name], _std(solution, one.name)
        rotation, std_rotation, applied = turned[one.name]
        view = replace(views[one.name], rotation_deg=rotation, std_deg=std_rotation, applied=applied)
        views[one.name] = view = view.with_values(ViewChange(found[:3], float(found[3]), float(found[4])), std[3:5])
        changes[one.name] = replace(view.change, rotation=view.change.rotation - one.turned)
    at = there.fits.at.moved(marginalise(there.model, there.fits, solution.calibration).own)
    alone = replace(solution.calibration, constants={})
    return RigEstimate(tuple(views.values()), undetermined, changes, alone, at, moved=True)


def _with_clear_scales(there: Linearised, scales: _Scales, names: Sequence[str]) -> tuple[Solved, Bool]:
    """Return the solution with those baselines and focal lengths that are clear of the file, and what is free (K,).

    What is not clear any more once the others are as in the file stays as there, too; ``scales`` is brought up to date.
    """
    solution, free = there.solution, np.ones(len(there.prior), dtype=np.bool_)
    clear: set[tuple[str, int]] | None = None
    while clear != (still := {key for key, scale in scales.items() if scale is not None and scale.applied}):
        clear = still
        for name in names:
            for unknown in _SCALES.values():
                free[solution.calibration.place(name).start + unknown] = (name, unknown) in clear
        if clear:
            solution = _solved(there, solution.calibration, free)
            scales |= {key: scale for key, scale in _scales(solution, names).items() if key in clear}
    return solution, free


def _solved(there: Linearised, calibration: Calibration, free: Bool) -> Solved:
    """Return the solution where constants that are not free (K,) are as in the file."""
    constants = {
        name: np.where(free[calibration.place(name)], block, 0.0) for name, block in calibration.constants.items()
    }
    pinned = np.diag(np.where(free, 0.0, np.diag(there.prior) * (_PINNED**-2 - 1)))
    return solve(there.model, there.fits, replace(calibration, constants=constants), there.prior + pinned)


def _std(solution: Solved, name: str) -> Float64:
    """Return the standard deviations (6,) of a view's unknowns."""
    return np.asarray(SHARED_ERRORS * np.sqrt(np.diag(solution.covariance)[solution.calibration.place(name)]))


def _scales(solution: Solved, names: Sequence[str]) -> _Scales:
    """Return what is told of the further views' baselines and focal lengths; None where it is not told."""
    out: _Scales = {}
    for name in names:
        found, std = solution.calibration.constants[name], _std(solution, name)
        for unknown, least in _LEAST_SCALE_STD.items():
            value, own = float(found[unknown]), float(np.hypot(std[unknown], least))
            clear = abs(value) > max(CLEAR * own, _LEAST_SCALE[unknown])
            told = own < TOLD * _STD[unknown]
            out[name, unknown] = ViewScale(float(np.exp(value)), own, clear) if told else None
    return out


def _with_scales(stated: ViewRotation, scales: _Scales) -> ViewRotation:
    """Return what is stated of a view with its baseline and focal length."""
    baseline, focal_length = (scales.get((stated.view, unknown)) for unknown in _SCALES.values())
    return replace(stated, baseline=baseline, focal_length=focal_length)


def _undetermined(stated: ViewRotation, scales: _Scales) -> list[str]:
    """Describe what of a view's baseline and focal length is not told."""
    undetermined = [name for name, unknown in _SCALES.items() if scales.get((stated.view, unknown), stated) is None]
    wide = "its standard deviation is as wide as expected beforehand"
    return [f"{name} of the {stated.view} eye: {wide}" for name in undetermined]
