"""Priors of the pose in one frame: joint readings and limits, given jaw tips, and a session's prediction.

Each is a sum of squares in units of its standard deviations, which is added to the term of the outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.geometry import change_between, moved
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.joints.prior import LIMIT_SIGMA, Readings
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

    def deviation(self, poses: Float64, joints: Float64) -> Float64:
        """Compute the small changes (..., 6 + J) from the mean to poses (..., 4, 4) and joints (..., J)."""
        return np.concatenate([change_between(self.camera_from_root, poses), joints - self.joints], axis=-1)


class Priors:
    """The sum of all priors of one frame: its value at poses, gradient and Gauss-Newton information.

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

    def cost(self, poses: Float64, joints: Float64) -> Float64:
        """Compute the sums of squares (C,) at poses (C, 4, 4) and their joints (C, J)."""
        cost = self._readings.cost(joints)
        if self._tips is not None:
            cost = cost + (self._tip_residuals(poses[:, None], joints[:, None]) ** 2).sum(axis=(1, 2))
        if self._expected is not None:
            off = self._expected.deviation(poses, joints)
            cost = cost + np.einsum("ci,ij,cj->c", off, self._expected.information, off)
        return cost

    def terms(self, poses: Float64, joints: Float64) -> tuple[Float64, Float64]:
        """Compute the information (C, 6 + J, 6 + J) and the slopes (C, 6 + J) at poses (C, 4, 4) and joints (C, J).

        The slopes are the gradients of half the sums of squares.
        """
        count = len(self._steps)
        information, slope = np.zeros((len(poses), count, count)), np.zeros((len(poses), count))
        low, high = self._readings.low - joints, joints - self._readings.high
        beyond = ((low > 0) | (high > 0)) / LIMIT_SIGMA**2
        information[:, range(6, count), range(6, count)] = self._weight + beyond
        slope[:, 6:] = self._weight * (joints - self._centre)
        slope[:, 6:] += (np.maximum(high, 0) - np.maximum(low, 0)) / LIMIT_SIGMA**2
        if self._tips is not None:
            change = np.concatenate([np.zeros((1, count)), np.diag(self._steps), -np.diag(self._steps)])
            residuals = self._tip_residuals(moved(poses[:, None], change[:, :6]), joints[:, None] + change[:, 6:])
            jacobian = (residuals[:, 1 : count + 1] - residuals[:, count + 1 :]) / (2 * self._steps[:, None])
            information += jacobian @ jacobian.swapaxes(1, 2)
            slope += (jacobian @ residuals[:, 0, :, None])[:, :, 0]
        if self._expected is not None:
            information += self._expected.information
            slope += self._expected.deviation(poses, joints) @ self._expected.information
        return information, slope

    def clip_to_limits(self, joints: Float64) -> Float64:
        """Clip joints (J,) to at most ``LIMIT_SIGMA`` beyond their limits."""
        return np.clip(joints, self._readings.low - LIMIT_SIGMA, self._readings.high + LIMIT_SIGMA)

    @property
    def _tips(self) -> Float64 | None:
        return self._evidence.tips if self._evidence.tips_given else None

    def _tip_residuals(self, poses: Float64, joints: Float64) -> Float64:
        """Compute projected less given tips, in units of their standard deviation, (C, S, 4).

        ``poses`` (C, S, 4, 4) with joints (C, S, J) are S variants of each of C candidates; the tips are paired as is
        better for the first of them.
        """
        tips = self._tips
        assert tips is not None
        shape = poses.shape[:2]
        flat = poses.reshape(-1, 4, 4), joints.reshape(-1, joints.shape[-1])
        projected = project_tips(self._instrument, self._evidence.camera, *flat).reshape(*shape, 2, 2)
        straight, crossed = projected - tips, projected - tips[::-1]
        better = (straight[:, 0] ** 2).sum(axis=(1, 2)) <= (crossed[:, 0] ** 2).sum(axis=(1, 2))
        chosen = np.where(better[:, None, None, None], straight, crossed)
        return np.asarray(chosen.reshape(*shape, 4) / self._keypoint_sigma)
