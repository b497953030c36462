"""How far readings are off from frame to frame, learnt from the session itself (expectation-maximisation).

Each frame's deviation from what is expected is shared out among the joints that can explain it; the mean of a joint's
squares, with a start that counts as so many frames, is its spread. The slack of the whole only shrinks: what is more
than expected is the joints' to explain. A single joint far off (a cable that slipped, a
reading of another moment) neither widens the spread nor drags the frame: its own spread is stretched.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.model import Calibration, SessionModel, Spreads
from dvrk_cmaes.calibration.solve import FrameViews, marginalise
from dvrk_cmaes.config import SessionConfig

Float64 = NDArray[np.float64]

_ROLL_STRETCH, _JOINT_STRETCH = 20.0, 2.0  # at most; the turn about the shaft is what a frame sees worst


def learn_spreads(
    model: SessionModel, views: FrameViews, calibration: Calibration, weights: Float64, config: SessionConfig
) -> SessionModel:
    """Return the model with the spreads that N frames, each of a weight (N,), show at a calibration."""
    start = Spreads.of(config, model.names)
    frames = marginalise(model, views, calibration)
    inverse = np.linalg.inv(model.covariance(calibration))

    def squares(cause: Float64) -> Float64:
        """Expect the squares (N,) of what moves the frames by so much a standard deviation of it, (N, D)."""
        gain = np.einsum("nij,nj->ni", inverse, cause)
        mean = (gain * frames.solved).sum(axis=1)
        left = 1 - (gain * cause).sum(axis=1) + np.einsum("ni,nij,nj->n", gain, frames.covariance, gain)
        return np.asarray(mean**2 + left)

    def spread(first: float, now: float, found: Float64, most: float) -> float:
        capped = np.minimum(found * now**2, (most * first) ** 2)
        total = config.spread_frames * first**2 + (weights * capped).sum()
        return float(np.sqrt(total / (config.spread_frames + weights.sum())))

    def loading(axis: int, deviation: Float64 | float) -> Float64:
        """Move each frame by a deviation along one of its own axes, (N, D)."""
        out = np.zeros((len(weights), 6 + len(start.joints)))
        out[:, axis] = deviation
        return out

    now, arm = model.spreads, model.outer_loadings(calibration)
    outer = start.outer.copy()
    turned = spread(start.outer[0], now.outer[0], (squares(arm[0]) + squares(arm[1])) / 2, config.arm_growth)
    slid = spread(start.outer[2], now.outer[2], squares(arm[2]), config.arm_growth / 2)
    outer[:2], outer[2] = max(turned, start.outer[0]), max(slid, start.outer[2])
    outer[3] = spread(start.outer[3], now.outer[3], squares(arm[3]), config.cable_growth)
    joints = np.zeros_like(start.joints)
    for j in range(len(joints)):
        own = squares(loading(6 + j, now.joints[j] * model.stretch[:, 1 + j]))
        joints[j] = spread(start.joints[j], now.joints[j], own, config.cable_growth)
    slack = start.slack.copy()
    for part in (slice(0, 3), slice(3, 6)):
        found = np.mean([squares(loading(k, now.slack[k])) for k in range(6)[part]], axis=0)
        slack[part] = spread(start.slack[part][0], now.slack[part][0], found, 1.0)
    learnt = Spreads(outer, joints, slack)
    off = np.concatenate([frames.solved[:, 5:6] / outer[3], frames.solved[:, 6:] / joints], axis=1)
    most = np.array([_ROLL_STRETCH] + [_JOINT_STRETCH] * len(joints))
    return model.with_spreads(learnt).with_stretch(np.clip(np.abs(off) / config.tail, 1.0, most))
