"""Check of the covariances of estimates: the share of 90 % intervals that contain the true value.

The covariance of an estimate is that of small changes of pose and joints. It is propagated to the jaw tips and to the
shaft's direction with Jacobians from central differences. The squared Mahalanobis distance of the error follows a
chi-squared distribution if the covariance is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.expected_error import INTERVAL, Quantity, jacobian, shaft_direction, tip_position
from measure.accuracy.errors import frame_errors
from measure.accuracy.figures import interval_figures
from measure.cases import Run, runs_by_level

Float64 = NDArray[np.float64]


def joint_value(index: int) -> Quantity:
    """Return the quantity: the value of one joint, (C, 1) rad."""
    return lambda at: at.joints[:, index : index + 1]


def quantities(instrument: Instrument, pose: Float64) -> dict[str, Quantity]:
    """Return the quantities whose intervals are checked, by name."""
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
    """Return the squared Mahalanobis distance of each quantity from its true value, and the degrees of freedom."""
    at, true = run.at(instrument), run.case.true(instrument)
    found = {}
    for name, quantity in quantities(instrument, run.pose).items():
        here = quantity(at[None])[0]
        truth = quantity(true[None])[0]
        slope = jacobian(quantity, at)
        covariance = slope @ run.covariance @ slope.T
        found[name] = float((truth - here) @ np.linalg.solve(covariance, truth - here)), len(here)
    return found


def calibration_report(instrument: Instrument, runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return one row for each level and quantity, of the runs in the right mode.

    ``held`` is the share of intervals that contain the truth; ``from`` and ``to`` are its 95 % confidence interval.
    ``rms_z`` is the root mean square of the error in standard deviations, and ``median_z`` the ratio of its median to
    the expected median; both are 1 if the covariances are right.
    """
    right = [run for run in runs if frame_errors(instrument, run).get("right_mode")]
    rows = []
    for level, group in runs_by_level(right).items():
        measured = [distances(instrument, run) for run in group]
        for name in measured[0]:
            squared = np.array([m[name][0] for m in measured])
            freedom = measured[0][name][1]
            rows.append(
                {"level": level, "quantity": name, "frames": len(squared)}
                | interval_figures(squared, freedom, INTERVAL)
            )
    return rows
