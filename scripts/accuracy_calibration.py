"""Whether stated uncertainties are true: how often the 90 % interval of a quantity holds its true value.

An estimate's covariance is that of small changes of pose and joints. It is carried over to the jaw tips and the shaft's
direction by central differences, and compared with the error by its Mahalanobis distance, which is chi-squared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from accuracy_cases import Run, by_level
from accuracy_errors import frame_errors
from numpy.typing import NDArray
from scipy.stats import beta, chi2

from dvrk_cmaes.geometry import frame_along, moved
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]
Quantity = Callable[[Float64, Float64], Float64]
"""Of poses (C, 4, 4) and joints (C, J), (C, n)."""

INTERVAL: Final = 0.9
_STEP: Final = 1e-5  # m and rad


def jacobian(quantity: Quantity, pose: Float64, joints: Float64) -> Float64:
    """Differentiate a quantity by small changes [t, r, joints], centrally: (n, 6 + J)."""
    count = 6 + len(joints)
    change = _STEP * np.concatenate([np.eye(count), -np.eye(count)])
    values = quantity(moved(pose, change[:, :6]), joints + change[:, 6:])
    return np.asarray((values[:count] - values[count:]).T / (2 * _STEP))


def tip_position(instrument: Instrument, which: Sequence[int]) -> Quantity:
    """Mean position of some jaw tips in the camera, (C, 3) m."""

    def position(poses: Float64, joints: Float64) -> Float64:
        tips = instrument.tips(joints)[:, list(which)].mean(axis=1)
        return np.asarray(np.einsum("nij,nj->ni", poses[:, :3, :3], tips) + poses[:, :3, 3])

    return position


def shaft_direction(instrument: Instrument, about: Float64) -> Quantity:
    """Direction of the shaft, as its two components (C, 2) across a given pose's (4, 4) own shaft."""
    along = np.array([0.0, 0.0, 1.0]) if instrument.shaft is None else instrument.shaft.direction
    across = frame_along(about[:3, :3] @ along)[:, :2]

    def direction(poses: Float64, joints: Float64) -> Float64:
        return np.asarray(poses[:, :3, :3] @ along @ across)

    return direction


def joint_value(index: int) -> Quantity:
    """One joint, (C, 1) rad."""
    return lambda poses, joints: joints[:, index : index + 1]


def quantities(instrument: Instrument, pose: Float64) -> dict[str, Quantity]:
    """All quantities whose intervals are tried, by name."""
    found: dict[str, Quantity] = {}
    if instrument.jaw_tips:
        found["tips, their middle"] = tip_position(instrument, (0, 1))
        found["tip 1"] = tip_position(instrument, (0,))
        found["tip 2"] = tip_position(instrument, (1,))
    found["axis direction"] = shaft_direction(instrument, pose)
    for k, name in enumerate(instrument.joint_names):
        found[name] = joint_value(k)
    return found


def distances(instrument: Instrument, run: Run) -> dict[str, tuple[float, int]]:
    """Squared Mahalanobis distance of the truth of each quantity, and its degrees of freedom."""
    assert run.case.truth is not None
    names = instrument.joint_names
    joints = np.array([run.joints[name] for name in names])
    true_joints = np.array([run.case.truth.joints[name] for name in names])
    found = {}
    for name, quantity in quantities(instrument, run.pose).items():
        here = quantity(run.pose[None], joints[None])[0]
        truth = quantity(run.case.truth.camera_from_root[None], true_joints[None])[0]
        slope = jacobian(quantity, run.pose, joints)
        spread = slope @ run.covariance @ slope.T
        found[name] = float((truth - here) @ np.linalg.solve(spread, truth - here)), len(here)
    return found


def share_interval(held: int, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Clopper and Pearson's interval of a share, from how many of a number of trials held."""
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, held, count - held + 1)) if held else 0.0
    high = float(beta.ppf(1 - tail, held + 1, count - held)) if held < count else 1.0
    return low, high


def calibration_report(instrument: Instrument, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row a level and quantity, of runs in the right mode.

    ``held``: share whose interval holds the truth; ``from``, ``to``: within which that share lies with 95 %
    confidence; ``rms_z``: root mean square of the error in standard deviations, 1 where they are right;
    ``median_z``: the median's ratio to what it should be.
    """
    right = [run for run in runs if frame_errors(instrument, run).get("right_mode")]
    rows = []
    for level, group in by_level(right).items():
        measured = [distances(instrument, run) for run in group]
        for name in measured[0]:
            squared = np.array([m[name][0] for m in measured])
            freedom = measured[0][name][1]
            held = int((squared <= chi2.ppf(INTERVAL, freedom)).sum())
            low, high = share_interval(held, len(squared))
            rows.append(
                {
                    "level": level,
                    "quantity": name,
                    "frames": len(squared),
                    "held": held / len(squared),
                    "from": low,
                    "to": high,
                    "rms_z": float(np.sqrt(squared.mean() / freedom)),
                    "median_z": float(np.sqrt(np.median(squared) / chi2.ppf(0.5, freedom))),
                }
            )
    return rows
