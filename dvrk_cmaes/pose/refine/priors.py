"""Priors of the pose in one frame: joint readings and limits, given jaw tips, and a session's prediction.

Each is a sum of squares in units of its standard deviations, which is added to the term of the outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.evidence.joint_prior import LIMIT_SIGMA, Readings
from dvrk_cmaes.geometry import change_between, moved
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.search.objective import project_tips

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PosePrior:
    """A normal prior of pose and joints.

    ``camera_from_root`` (4, 4) and ``joints`` (J,) are the mean; ``information`` (6 + J, 6 + J) is the inverse
    covariance of the small changes [tx ty tz rx ry rz, joints] from it, in the root link's axes, m and rad.
    """

    camera_from_root: Float64
    joints: Float64
    information: Float64

    def deviation(self, pose: Float64, joints: Float64) -> Float64:
        """Compute the small change (6 + J,) from the mean to a pose (4, 4) and joints (J,)."""
        return np.concatenate([change_between(self.camera_from_root, pose), joints - self.joints])


class Priors:
    """The sum of all priors of one frame: its value at a pose, gradient and Gauss-Newton information.

    ``keypoint_sigma``, px, is the standard deviation of given tips; ``steps`` (6 + J,) are for central differences.
    """

    def __init__(
        self,
        instrument: Instrument,
        evidence: Evidence,
        readings: Readings,
        *,
        keypoint_sigma: float,
        steps: Float64,
        expected: PosePrior | None = None,
    ) -> None:
        self._instrument = instrument
        self._evidence = evidence
        self._readings = readings
        self._keypoint_sigma = keypoint_sigma
        self._steps = steps
        self._expected = expected
        known = ~np.isnan(readings.values)
        self._weight = np.where(known, 1 / readings.sigma**2, 0.0)
        self._centre = np.where(known, readings.values, 0.0)

    def cost(self, pose: Float64, joints: Float64) -> float:
        """Compute the sum of squares at a pose (4, 4) and its joints (J,)."""
        cost = float(self._readings.cost(joints))
        if self._tips is not None:
            cost += float((self._tip_residuals(pose[None], joints[None]) ** 2).sum())
        if self._expected is not None:
            off = self._expected.deviation(pose, joints)
            cost += float(off @ self._expected.information @ off)
        return cost

    def add(self, information: Float64, slope: Float64, pose: Float64, joints: Float64) -> None:
        """Add the information (6 + J, 6 + J) and the slope (6 + J,) of the priors at a pose in place.

        The slope is the gradient of half the sum of squares.
        """
        information[6:, 6:] += np.diag(self._weight)
        slope[6:] += self._weight * (joints - self._centre)
        low, high = self._readings.low - joints, joints - self._readings.high
        information[6:, 6:] += np.diag(((low > 0) | (high > 0)) / LIMIT_SIGMA**2)
        slope[6:] += (np.maximum(high, 0) - np.maximum(low, 0)) / LIMIT_SIGMA**2
        if self._tips is not None:
            count = len(self._steps)
            change = np.concatenate([np.zeros((1, count)), np.diag(self._steps), -np.diag(self._steps)])
            residuals = self._tip_residuals(moved(pose, change[:, :6]), joints + change[:, 6:])
            jacobian = (residuals[1 : count + 1] - residuals[count + 1 :]) / (2 * self._steps[:, None])
            information += jacobian @ jacobian.T
            slope += jacobian @ residuals[0]
        if self._expected is not None:
            information += self._expected.information
            slope += self._expected.information @ self._expected.deviation(pose, joints)

    def clip_to_limits(self, joints: Float64) -> Float64:
        """Clip joints (J,) to at most ``LIMIT_SIGMA`` beyond their limits."""
        return np.clip(joints, self._readings.low - LIMIT_SIGMA, self._readings.high + LIMIT_SIGMA)

    @property
    def _tips(self) -> Float64 | None:
        return self._evidence.tips if self._evidence.tips_given else None

    def _tip_residuals(self, poses: Float64, joints: Float64) -> Float64:
        """Compute projected less given tips in the better pairing, in units of their standard deviation, (C, 4)."""
        tips = self._tips
        assert tips is not None
        projected = project_tips(self._instrument, self._evidence.camera, poses, joints)
        straight, crossed = projected - tips, projected - tips[::-1]
        better = (straight**2).sum(axis=(1, 2)) <= (crossed**2).sum(axis=(1, 2))
        chosen = np.where(better[0], straight, crossed)
        return np.asarray(chosen.reshape(len(poses), 4) / self._keypoint_sigma)
