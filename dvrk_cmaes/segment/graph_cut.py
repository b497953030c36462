"""Binary segmentation by a minimum graph cut over the log-odds of pixels, by OpenCV's GrabCut.

OpenCV offers its graph cut only as part of GrabCut, which models foreground and background by mixtures of Gaussians
over three colour channels. Here the first channel holds the log-odds, and each mixture is one Gaussian, of equal
variances, with its mean at one end of the channel's range: the difference of their log-likelihoods is linear in the
channel, hence proportional to the log-odds. The other two channels hold the guide image whose edges the outline
follows; in these the two Gaussians are equal and nearly flat.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Bool, Float32, Image

LARGEST = 5.0  # bound of the log-odds
_RANGE = 80  # levels of the log-odds' channel; few, so that its edges contribute little to the smoothness term
_GUIDE = 200  # levels of the other two channels
_SAMPLED = 320  # px, longer side of a guide whose range is that of all pixels, and not of every second one or fewer
_WEIGHT = 10.0  # of the log-odds against the smoothness term, whose weight in GrabCut is 50


def levels(guide: Float32) -> Image:
    """Return the levels (H, W, 2) of a guide (H, W, 2) for cuts: the outline costs less where these change."""
    step = max(max(guide.shape) // _SAMPLED, 1)
    low, high = np.percentile(guide[::step, ::step], [1, 99], axis=(0, 1))
    return np.asarray(np.clip((guide - low) / (high - low + 1e-6) * _GUIDE, 0, 255), np.uint8)


def cut(log_odds: Float32, guide: Image, *, background: Bool, tool: Bool) -> Bool:
    """Label pixels as instrument or background by a minimum cut.

    Parameters
    ----------
    log_odds
        (H, W), of instrument against background.
    guide
        (H, W, 2), its `levels`.
    background, tool
        (H, W), pixels whose label is given.

    Returns
    -------
    (H, W) bool
        True on the instrument.
    """
    picture = np.zeros((*log_odds.shape, 3), np.uint8)
    picture[..., 0] = np.round((np.clip(log_odds, -LARGEST, LARGEST) / LARGEST + 1) * _RANGE / 2)
    picture[..., 1:] = guide
    labels = np.full(log_odds.shape, cv2.GC_PR_FGD, np.uint8)
    labels[background] = cv2.GC_BGD
    labels[tool] = cv2.GC_FGD
    cv2.grabCut(picture, labels, (0, 0, 1, 1), _mixture(0), _mixture(_RANGE), 1, cv2.GC_EVAL_FREEZE_MODEL)
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


def _mixture(mean: float) -> NDArray[np.float64]:
    """Return GrabCut's model (1, 65) with one Gaussian of weight 1: five weights, five means, five covariances."""
    # the log-odds differ by range^2 / variance over the channel's range, to be 2 * LARGEST * _WEIGHT
    variance = _RANGE**2 / (2 * LARGEST * _WEIGHT)
    model = np.zeros((1, 65))
    model[0, 0] = 1
    model[0, 5:8] = mean, _GUIDE / 2, _GUIDE / 2
    covariances = model[0, 20:].reshape(5, 3, 3)
    covariances[:] = np.eye(3)
    covariances[0] = np.diag([variance, 1e6, 1e6])
    return model
