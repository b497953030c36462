"""The margin by which all masks of a view are too wide or too narrow, estimated beside a session's calibration.

A single frame cannot tell a margin from a shorter distance. In a session the arm moves along the optical axis by
amounts that its joints state, and a margin makes near and far shafts wider by the same number of pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.camera_change import MARGIN_STD, SessionOutlines, shifted
from dvrk_cmaes.calibration.few_frames import few_of
from dvrk_cmaes.calibration.model import Calibration, SessionModel
from dvrk_cmaes.calibration.session_camera import file_deviations
from dvrk_cmaes.calibration.session_masks import Margin
from dvrk_cmaes.calibration.solve import marginalise, solve
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Posed

Float64 = NDArray[np.float64]

_CLEAR = 2.5  # standard deviations from zero, and ...
_LEAST_MARGIN = 0.15  # ... px, beyond which a margin is taken off the masks
_LEAST_STD = 0.12  # px; margins of parts of one real recording, 0.57 to 1.11, scatter by this beside their errors
_PASSES = 5  # largest number of linearisations of the outlines
_MARGIN_STEPS = 2  # linearisations of the outlines from whole masks to those less the margin
_SETTLED = 0.5  # standard deviations of the margin, below which the outlines are not linearised again


@dataclass(frozen=True, eq=False)
class MarginEstimate:
    """The margin of a view's masks, the ``calibration`` with it, and ``at``, where the N frames are with it.

    Both are those with the camera of the file.
    """

    margin: Margin
    calibration: Calibration
    at: Posed


def estimate_margin(
    model: SessionModel,
    calibration: Calibration,
    prior: Float64,
    config: SessionConfig,
    at: Posed,
    outlines: SessionOutlines,
) -> MarginEstimate:
    """Estimate the margin of the masks beside the calibration and the camera, whose file counts as a measurement.

    Parameters
    ----------
    model, calibration
        The session's model and its calibration with whole masks.
    prior : (K, K)
        Information matrix of the calibration's prior, as in `solve`.
    config
        Standard deviations of the camera file.
    at
        The poses of the N frames.
    outlines
        The same frames' outlines in the view.
    """
    further = np.array([*file_deviations(config), MARGIN_STD])
    padded = np.pad(prior, (0, 4)) + np.diag([*np.zeros(len(prior)), *further**-2])
    start, poses, passes = replace(calibration, further=np.array([*np.zeros(3), outlines.margin])), at, _PASSES
    index = few_of(len(at))
    if index is not None:
        near = _linearised(model.subset(index), start, padded, at[index], outlines.subset(index), passes - 1)
        poses = shifted(model, at, start, near.calibration)
        start, passes = near.calibration, passes - near.passes
    there = _linearised(model, start, padded, poses, outlines, passes)
    margin, std = float(there.calibration.further[3]), there.std
    clear = abs(margin) > max(_CLEAR * std, _LEAST_MARGIN)
    if clear:
        calibration, at = _with_margin(model, calibration, prior, at, outlines, margin)
    return MarginEstimate(Margin(margin, std, clear), calibration, at)


@dataclass(frozen=True)
class _There:
    """The calibration with the margin, its last constant, whose standard deviation is ``std``, px.

    ``passes`` is the number of linearisations that led there.
    """

    calibration: Calibration
    std: float
    passes: int


def _linearised(
    model: SessionModel, there: Calibration, prior: Float64, at: Posed, outlines: SessionOutlines, passes: int
) -> _There:
    """Solve for calibration, camera and margin, linearising the outlines until the margin does not change any more."""
    done, settled = 0, False
    while not settled and done < passes:
        done, before = done + 1, there.further
        fits = outlines.near(at, before)
        solution = solve(model, fits, there, prior)
        there, at = solution.calibration, at.moved(marginalise(model, fits, solution.calibration).own)
        std = float(np.hypot(np.sqrt(solution.covariance[-1, -1]), _LEAST_STD))
        settled = abs(there.further[3] - before[3]) < _SETTLED * std
    return _There(there, std, done)


def _with_margin(
    model: SessionModel, calibration: Calibration, prior: Float64, at: Posed, outlines: SessionOutlines, margin: float
) -> tuple[Calibration, Posed]:
    """Return the calibration and the poses of the N frames with the camera of the file and masks less a margin, px.

    The other arguments are as in `estimate_margin`. Beside the margin, a change of the camera is estimated that is not
    used: poses with that may be many pixels off with the camera of the file.
    """
    constants = np.array([0.0, 0.0, 0.0, margin])
    for _ in range(_MARGIN_STEPS):
        fits = outlines.near(at, constants).at_constants()
        calibration = solve(model, fits, calibration, prior).calibration
        at = at.moved(marginalise(model, fits, calibration).own)
    return calibration, at
