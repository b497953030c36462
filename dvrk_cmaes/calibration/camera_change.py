"""Estimation of a change of the camera beside a session's calibration.

The change has three unknowns: the logarithm of the focal length's factor and the shift of the principal point, px. They
are further constants of the calibration, on which the outlines depend, and so is the margin of the masks, which makes
the shaft wider as a longer focal length does. A single frame hardly determines them, because a
change of its pose has nearly the same effect. In a session, the arm's kinematics fix the distances between the remote
centre of motion and the wrists, and thereby the scale along the optical axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.few_frames import few_of
from dvrk_cmaes.calibration.frame_task import ConstantsTask, Run, constants_task
from dvrk_cmaes.calibration.lasting_errors import CommonErrors
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, marginalise
from dvrk_cmaes.calibration.stored_frame import StoredFrame, changed
from dvrk_cmaes.calibration.variances import solve_with_variances
from dvrk_cmaes.camera.critical import FILE
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.shared_errors import LASTING
from dvrk_cmaes.pose.terms.term import Quadratic

Float64 = NDArray[np.float64]

WEAK_PRIOR = np.array([0.3, 300.0, 300.0])
"""Standard deviations of the prior with which the change is estimated from the frames: relative, and px."""

MARGIN_STD = 1.0
"""Standard deviation, px, of the margin by which a segmenter makes masks too wide or too narrow."""

_LEAST_EIGENVALUE = 1e-12  # of an information matrix whose diagonal is scaled to 1
_BASE_STD = 1.0, 1.0  # m and rad, of the base beforehand, some of which a session may not determine
_SETTLED = 0.25  # standard deviations of the change, below which the outlines are not linearised again
_STEPS = 10  # largest number of Gauss-Newton steps between two estimates of the variances
_PLAUSIBLE = 2.0  # standard deviations of `WEAK_PRIOR`; linearised farther away, outlines leave the image


@dataclass(frozen=True, eq=False)
class SessionOutlines:
    """The outlines of N frames in one view, as functions of poses, joints and four constants.

    The constants are a change of that view's camera and the margin of its masks, px. ``stored`` are the frames with the
    unchanged camera, ``views`` (N,) the numbers of the view in them. Those for which this is None do not influence the
    estimate. ``run`` applies a function to many tasks. ``margin``, px, is the value of the margin from which estimates
    start. ``common`` are the errors that the frames share.
    """

    stored: Sequence[StoredFrame]
    views: Sequence[int | None]
    run: Run[Any, Any]
    common: CommonErrors
    margin: float = 0.0

    @property
    def width(self) -> int:
        """Width of the images, px, to which changes of the camera refer."""
        return self._evidence[0].camera.width

    @property
    def unusual(self) -> bool:
        """Whether the file of the camera has unusual values."""
        return any(text.startswith(FILE) for text in self._evidence[0].camera.remarks)

    @property
    def _evidence(self) -> list[Evidence]:
        """Evidence of the view in each frame; that of another view where the frame does not count."""
        return [one.views[view or 0].stored.evidence for one, view in zip(self.stored, self.views, strict=True)]

    def near(self, at: Posed, constants: Float64) -> FrameFits:
        """Linearise the outlines at N poses and values (4,) of the constants, in both.

        Raises
        ------
        InputError
            With the changed focal length, the lens distortion is not one-to-one over the image.
        """
        tasks = [
            ConstantsTask(self.stored[k], view, at[k], changed(evidence.camera, constants[:3]), float(constants[3]))
            for k, (view, evidence) in enumerate(zip(self.views, self._evidence, strict=True))
            if view is not None
        ]
        found = iter(self.run(constants_task, tasks))
        nothing = Quadratic.zero(1, 6 + at.joints.shape[1] + len(constants) + LASTING)
        terms = [nothing if view is None else next(found) for view in self.views]
        return FrameFits.with_lasting(at, terms, self.common, constants)

    def subset(self, index: NDArray[np.intp]) -> SessionOutlines:
        """Return the outlines of the frames at some indices."""
        chosen = index.tolist()
        return replace(
            self,
            stored=[self.stored[i] for i in chosen],
            views=[self.views[i] for i in chosen],
            common=self.common.subset(index),
        )


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """The change (3,) of the camera that a session's frames fit best, and the calibration with it.

    ``covariance`` (3, 3) is that of the change, whose prior is `WEAK_PRIOR`. ``sensitivity`` (K, 3) is the derivative
    of the calibration, in the order of `SessionModel.axes`, by the change. ``at`` are the poses of the N frames with
    the changed camera. ``plausible`` is false if an estimate on the way lay so far away that the outlines said nothing
    about it. ``first_change`` (3,) and ``first_covariance`` (3, 3) are what the first linearisation told, at the start.
    ``margin``, px, is that of the masks with the changed camera; ``passes`` is the number of linearisations.
    """

    change: Float64
    covariance: Float64
    first_change: Float64
    first_covariance: Float64
    sensitivity: Float64
    calibration: Calibration
    at: Posed
    plausible: bool = True
    margin: float = 0.0
    passes: int = 1


def estimate_camera(
    model: SessionModel,
    calibration: Calibration,
    prior: Float64,
    config: SessionConfig,
    at: Posed,
    outlines: SessionOutlines,
    *,
    start: Float64 | None = None,
    passes: int,
) -> CameraEstimate:
    """Estimate the change of the camera beside the calibration, by Gauss-Newton steps for all frames and both.

    Of many frames, few lead to where the outlines of all are then linearised.

    Parameters
    ----------
    model, calibration
        The session's model and its calibration with the camera of ``start``.
    prior : (K, K)
        Information matrix of the calibration's prior, as in `solve`.
    config
        Settings of the variance components, which are estimated again with the changed camera.
    at
        The poses of the N frames with the camera of ``start``.
    outlines
        The same frames' outlines.
    start
        Change (3,) of the camera from which the estimation starts; none by default.
    passes
        Largest number of linearisations of the outlines.

    Raises
    ------
    InputError
        As `SessionOutlines.near`.
    """
    index = few_of(len(at)) if passes > 1 else None
    found: list[tuple[Float64, Float64]] = []
    if index is not None:
        own, of_few = at[index], outlines.subset(index)
        few = estimate_camera(
            model.subset(index), calibration, prior, config, own, of_few, start=start, passes=passes - 1
        )
        if few.plausible:
            found = [(few.first_change, few.first_covariance)] * few.passes
            at = shifted(model, at, calibration, few.calibration)
            calibration, start, outlines = few.calibration, few.change, replace(outlines, margin=few.margin)
    constants = np.array([*(np.zeros(3) if start is None else start), outlines.margin])
    calibration = replace(calibration, further=constants)
    count, plausible = len(prior), True
    of_camera = slice(count, count + 3)
    prior = np.pad(prior, (0, 4)) + np.diag([*np.zeros(count), *WEAK_PRIOR**-2, MARGIN_STD**-2])
    weak = np.diag([*[_BASE_STD[0] ** -2] * 3, *[_BASE_STD[1] ** -2] * 3, *[0.0] * (count - 2)])
    while len(found) < passes:
        before, fits = constants[:3], outlines.near(at, constants)
        model, solution = solve_with_variances(model, fits, calibration, prior, config, steps=_STEPS)
        calibration, constants = solution.calibration, solution.calibration.further
        change, information = constants[:3], solution.information + weak
        covariance = solution.covariance_of(_inverse(information))[of_camera, of_camera]
        found.append((change, covariance))
        at = at.moved(marginalise(model, fits, calibration).own)
        plausible = bool((np.abs(change) < _PLAUSIBLE * WEAK_PRIOR).all())
        if not plausible or (np.abs(change - before) < _SETTLED * np.sqrt(np.diag(covariance))).all():
            break
    sensitivity = -_inverse(information[:count, :count]) @ information[:count, of_camera]
    calibration = replace(calibration, further=np.zeros(0))
    margin, done = float(constants[3]), len(found)
    return CameraEstimate(
        change, covariance, *found[0], sensitivity, calibration, at, plausible=plausible, margin=margin, passes=done
    )


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


def _inverse(information: Float64) -> Float64:
    """Invert an information matrix (K, K), which rounding may have left with negative eigenvalues."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale))
