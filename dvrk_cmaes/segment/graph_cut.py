"""The smoothest mask that still agrees with the log-odds of its pixels: a minimum cut, by OpenCV.

OpenCV cuts graphs only inside GrabCut, whose pixels must have colours that two mixtures of Gaussians explain. Here the
first of three colour channels holds the log-odds, and the two mixtures are one Gaussian each, of equal spread, about
the channel's two ends: the difference of their log-likelihoods is linear in the channel, hence the log-odds. In the
other two channels both are the same and as good as flat; these hold what the outline should follow the edges of.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]

LARGEST = 5.0  # log-odds beyond which more makes no difference
_RANGE = 80  # levels of the channel of log-odds: few, so that its own edges count little
_GUIDE = 200  # levels of the other two
_WEIGHT = 10.0  # of log-odds against length of outline, where GrabCut has 50 for a pixel's


def cut(log_odds: Float32, guide: Float32, *, background: Bool | None = None, tool: Bool | None = None) -> Bool:
    """Cut the instrument out.

    Parameters
    ----------
    log_odds
        (H, W), of instrument against background.
    guide
        (H, W, 2); the outline costs less where these change.
    background, tool
        (H, W), where the answer is known.

    Returns
    -------
    (H, W) bool
    """
    picture = np.zeros((*log_odds.shape, 3), np.uint8)
    picture[..., 0] = np.round((np.clip(log_odds, -LARGEST, LARGEST) / LARGEST + 1) * _RANGE / 2)
    for k in range(2):
        low, high = np.percentile(guide[..., k], [1, 99])
        picture[..., 1 + k] = np.clip((guide[..., k] - low) / (high - low + 1e-6) * _GUIDE, 0, 255)
    labels = np.full(log_odds.shape, cv2.GC_PR_FGD, np.uint8)
    if background is not None:
        labels[background] = cv2.GC_BGD
    if tool is not None:
        labels[tool] = cv2.GC_FGD
    cv2.grabCut(picture, labels, (0, 0, 1, 1), _mixture(0), _mixture(_RANGE), 1, cv2.GC_EVAL_FREEZE_MODEL)
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


def _mixture(mean: float) -> NDArray[np.float64]:
    """GrabCut's model, (1, 65): weights of five Gaussians, their means, their covariances; only the first counts."""
    # log-odds over the channel's range are range^2 / variance, and shall be 2 * LARGEST * _WEIGHT
    variance = _RANGE**2 / (2 * LARGEST * _WEIGHT)
    model = np.zeros((1, 65))
    model[0, 0] = 1
    model[0, 5:8] = mean, _GUIDE / 2, _GUIDE / 2
    covariances = model[0, 20:].reshape(5, 3, 3)
    covariances[:] = np.eye(3)
    covariances[0] = np.diag([variance, 1e6, 1e6])
    return model
