"""Estimation of a change of the camera beside a session's calibration.

The unknowns c are the logarithm of the focal length's factor and the shift of the principal point, px. A single frame
hardly determines them, because a change of its pose has nearly the same effect. In a session, the arm's kinematics fix
the distances between the remote centre of motion and the wrists, and thereby the scale along the optical axis.

Let H, B and C be the blocks of the information of a frame's outline about its pose x and the camera, s and t its
slopes there, and W the information of the session's prediction p, all relative to the point of expansion. Elimination
of x, with S = (H + W)^-1, leaves x = S (W p - s - B c), the gradients W (p - x) about the prediction and
B^T x + C c + t about the camera, and the Hessian's blocks W - W S W, W S B and C - B^T S B.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.frame_task import CameraTask, Run, camera_task
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.own_estimate import OwnEstimate
from dvrk_cmaes.calibration.solve import FrameFits, marginalise, robust_weights
from dvrk_cmaes.calibration.stored_frame import StoredEvidence
from dvrk_cmaes.calibration.variances import estimate_variances
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Posed, moved

Float64 = NDArray[np.float64]

WEAK_PRIOR = np.array([0.3, 300.0, 300.0])
"""Standard deviations of the prior with which the change is estimated from the frames: relative, and px."""

_LEAST_EIGENVALUE = 1e-12  # of an information matrix whose diagonal is scaled to 1
_BASE_STD = 1.0, 1.0  # m and rad, of the base beforehand, some of which a session may not determine
_SETTLED = 0.25  # standard deviations of the change, below which the outlines are not linearised again
_PLAUSIBLE = 2.0  # standard deviations of `WEAK_PRIOR`; linearised farther away, outlines leave the image
_EM_ITERATIONS = 3  # estimates of the calibration and the variance components for each linearisation
_STEPS = 10  # largest number of Gauss-Newton steps of each


@dataclass(frozen=True, eq=False)
class CameraTerms:
    """Quadratic approximations of the outline terms of N frames about poses, joints and the camera.

    ``fits`` are those about poses and joints, with the camera changed by ``change`` (3,). ``cross`` (N, D, 3) is the
    block of the information between these and the camera; ``information`` (N, 3, 3) and ``slope`` (N, 3) are those
    about the camera.
    """

    fits: FrameFits
    change: Float64
    cross: Float64
    information: Float64
    slope: Float64

    @classmethod
    def of(
        cls, poses: Float64, joints: Float64, change: Float64, terms: Sequence[tuple[Float64, Float64]]
    ) -> CameraTerms:
        """Split terms (D + 3, D + 3) and (D + 3,) of each frame at poses (N, 4, 4), joints (N, J) and a change (3,)."""
        whole, slopes = np.array([one for one, _ in terms]), np.array([one for _, one in terms])
        fits = FrameFits(poses, joints, whole[:, :-3, :-3], slopes[:, :-3])
        return cls(fits, change, whole[:, :-3, -3:], whole[:, -3:, -3:], slopes[:, -3:])

    def fits_at(self, change: Float64) -> FrameFits:
        """Return the approximations about poses and joints with the camera changed by ``change`` (3,)."""
        return replace(self.fits, slope=self.fits.slope + self.cross @ (change - self.change))


@dataclass(frozen=True, eq=False)
class SessionOutlines:
    """The outlines of N frames in the reference camera, as functions of poses, joints and a change of that camera.

    ``stored`` are the frames' evidence, ``readings`` theirs by joint name, ``own_estimates`` their own estimates with
    the unchanged camera. Frames for which ``used`` (N,) is false do not influence the estimate. ``run`` applies a
    function to many tasks.
    """

    stored: tuple[StoredEvidence, ...]
    readings: tuple[Mapping[str, float], ...]
    own_estimates: tuple[OwnEstimate, ...]
    used: NDArray[np.bool_]
    run: Run[Any, Any]

    def cameras(self, change: Float64) -> list[Camera]:
        """Return the frames' cameras after a change (3,); InputError as `Camera.changed`."""
        return [changed(stored.evidence.camera, change) for stored in self.stored]

    @property
    def width(self) -> int:
        """Width of the images, px, to which changes of the camera refer."""
        return self.stored[0].evidence.camera.width

    def terms(self, change: Float64, poses: Float64, joints: Float64) -> CameraTerms:
        """Linearise the outlines at a change (3,), poses (N, 4, 4) and joints (N, J).

        Raises
        ------
        InputError
            With the changed focal length, the lens distortion is not one-to-one over the image.
        """
        tasks = [
            CameraTask(stored, readings, Posed(pose, joint), own, camera)
            for stored, readings, own, pose, joint, camera in zip(
                self.stored, self.readings, self.own_estimates, poses, joints, self.cameras(change), strict=True
            )
        ]
        found = self.run(camera_task, tasks)
        terms = [(used * matrix, used * slope) for used, (matrix, slope) in zip(self.used, found, strict=True)]
        return CameraTerms.of(poses, joints, change, terms)


def changed(camera: Camera, change: Float64) -> Camera:
    """Return a camera after a change (3,); InputError as `Camera.changed`."""
    return camera.changed(float(np.exp(change[0])), (float(change[1]), float(change[2])))


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """The change (3,) of the camera that a session's frames fit best, and the calibration with it.

    ``covariance`` (3, 3) is that of the change, whose prior is `WEAK_PRIOR`. ``sensitivity`` (K, 3) is the derivative
    of the calibration, in the order of `SessionModel.axes`, by the change. ``poses`` (N, 4, 4) and ``joints`` (N, J),
    rad, are the frames' with the changed camera. ``plausible`` is false if an estimate on the way lay so far
    away that the outlines said nothing about it.
    """

    change: Float64
    covariance: Float64
    sensitivity: Float64
    calibration: Calibration
    poses: Float64
    joints: Float64
    plausible: bool = True


def estimate_camera(
    model: SessionModel,
    calibration: Calibration,
    prior: Float64,
    config: SessionConfig,
    fits: FrameFits,
    outlines: SessionOutlines,
    *,
    start: Float64 | None = None,
    passes: int,
) -> CameraEstimate:
    """Estimate the change of the camera beside the calibration, by Gauss-Newton steps for all frames and both.

    Parameters
    ----------
    model, calibration
        The session's model and its calibration with the camera of ``start``.
    prior : (K, K)
        Information matrix of the calibration's prior, as in `solve`.
    config
        Settings of the variance components, which are estimated again with the changed camera.
    fits
        The frames' fits with the camera of ``start``.
    outlines
        The same frames' outlines.
    start
        Change (3,) of the camera from which the estimation starts; none by default.
    passes
        Largest number of linearisations of the outlines.

    Raises
    ------
    InputError
        As `SessionOutlines.terms`.
    """
    change = np.zeros(3) if start is None else start
    poses, joints = fits.poses, fits.joints
    weak = np.diag([*[_BASE_STD[0] ** -2] * 3, *[_BASE_STD[1] ** -2] * 3, *[0.0] * (len(prior) - 3)])
    plausible = True
    for _ in range(passes):
        before, terms = change, outlines.terms(change, poses, joints)
        for _ in range(_EM_ITERATIONS):
            calibration, change, information = _solve(model, terms, calibration, change, prior)
            weights = _Linearised.at(model, terms, calibration, change).weights
            model = estimate_variances(model, terms.fits_at(change), calibration, weights, config)
        covariance = _inverse(information + weak)[-3:, -3:]
        frames = marginalise(model, terms.fits_at(change), calibration)
        poses, joints = moved(poses, frames.step[:, :6]), joints + frames.step[:, 6:]
        plausible = bool((np.abs(change) < _PLAUSIBLE * WEAK_PRIOR).all())
        if not plausible or (np.abs(change - before) < _SETTLED * np.sqrt(np.diag(covariance))).all():
            break
    sensitivity = -_inverse((information + weak)[:-3, :-3]) @ information[:-3, -3:]
    return CameraEstimate(change, covariance, sensitivity, calibration, poses, joints, plausible=plausible)


def _inverse(information: Float64) -> Float64:
    """Invert an information matrix (K, K), which rounding may have left with negative eigenvalues."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-12))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale))


def _solve(
    model: SessionModel, terms: CameraTerms, calibration: Calibration, change: Float64, prior: Float64
) -> tuple[Calibration, Float64, Float64]:
    """Estimate calibration and change (3,) by reweighted Gauss-Newton steps.

    Returns both, and their information matrix (K + 3, K + 3).
    """
    count = len(prior)
    whole_prior = np.zeros((count + 3, count + 3))
    whole_prior[:count, :count] = prior
    whole_prior[count:, count:] = np.diag(WEAK_PRIOR**-2)
    for _ in range(_STEPS):
        here = _Linearised.at(model, terms, calibration, change)
        information = here.information + whole_prior
        at = np.concatenate([np.zeros(6), calibration.offsets, change])
        step = -np.linalg.solve(information, here.slope + whole_prior @ at)
        calibration, change = calibration.changed(step[:count]), change + step[count:]
        if step @ information @ step < 1e-6 * len(step):
            break
    return calibration, change, np.asarray(information)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Sums over the frames at a calibration and a change of the camera, both unknowns together.

    ``information`` (K + 3, K + 3) and ``slope`` (K + 3,) are without priors; ``weights`` (N,) are the frames'.
    """

    information: Float64
    slope: Float64
    weights: Float64

    @classmethod
    def at(cls, model: SessionModel, terms: CameraTerms, calibration: Calibration, change: Float64) -> _Linearised:
        """Eliminate each frame's pose and joints, and add up the frames with robust weights."""
        frames = marginalise(model, terms.fits_at(change), calibration)
        jacobian = model.jacobian(calibration)
        of_predictions = np.swapaxes(jacobian, 1, 2)
        from_camera = np.swapaxes(terms.cross, 1, 2)
        coupling = of_predictions @ np.swapaxes(frames.gain, 1, 2) @ terms.cross
        information = np.block(
            [
                [of_predictions @ frames.information @ jacobian, coupling],
                [np.swapaxes(coupling, 1, 2), terms.information - from_camera @ frames.covariance @ terms.cross],
            ]
        )
        about_camera = (from_camera @ frames.step[..., None])[..., 0] + terms.slope
        about_camera += terms.information @ (change - terms.change)
        about_calibration = (of_predictions @ frames.slope[..., None])[..., 0]
        slope = np.concatenate([about_calibration, about_camera], axis=1)
        weights = robust_weights(frames.misfit, 6 + len(model.names))
        return cls(np.einsum("n,nij->ij", weights, information), weights @ slope, weights)
