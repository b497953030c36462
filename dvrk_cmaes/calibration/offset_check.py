"""Warnings about offsets of joint readings that lie far outside their priors, with likely causes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.model import OUTER_OFFSETS, Calibration, SessionModel

Float64 = NDArray[np.float64]

_FAR = 3.0  # standard deviations of prior and estimate together
_CAUSES: Mapping[str, str] = {
    "insertion": "another focal length than the camera file's, a tool or arm of another length (--tool, --arm), or a "
    "lag between images and readings that is not taken out",
    "roll": "a tool that was exchanged or homed during the recording, readings of another tool, or a lag between "
    "images and readings that is not taken out",
}
_CAUSES_OF_CABLES = "a tool that was not homed, a coupling of another tool, or slipped cables"


def describe_far_offsets(
    calibration: Calibration, covariance: Float64, model: SessionModel, prior_std: Float64
) -> list[str]:
    """Describe each offset beyond three standard deviations of its prior and its estimate together.

    Parameters
    ----------
    calibration, covariance
        The estimated calibration and its covariance (8 + J, 8 + J), in the order of `SessionModel.axes`.
    model
        The session's model, for the names of the joints.
    prior_std : (2 + J,)
        Standard deviations of the offsets' priors about zero, m and rad.
    """
    std = np.sqrt(np.diag(covariance))[6:]
    texts = []
    for name, offset, own, prior in zip(
        (*OUTER_OFFSETS, *model.names), calibration.offsets, std, prior_std, strict=True
    ):
        if abs(offset) <= _FAR * np.hypot(own, prior):
            continue
        unit, factor = ("mm", 1e3) if name == "insertion" else ("deg", float(np.degrees(1)))
        texts.append(
            f"offset of {name}: {factor * offset:+.1f} {unit} (std {factor * own:.1f}), where {factor * prior:.1f} "
            f"{unit} are usual; likely causes: {_CAUSES.get(name, _CAUSES_OF_CABLES)}"
        )
    return texts
