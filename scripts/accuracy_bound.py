"""The smallest errors that a mask on a pixel grid allows, and how near to them the estimates come.

Model. An exact outline is known from the mask once a row where it is steep, and once a column where it is flat: between
which two pixel centres it passes. That is one measurement of where the outline crosses the row, with an error that is
uniform over a pixel, standard deviation 1 / sqrt(12) px, independent of the next row's, taken as Gaussian. Readings are
Gaussian with their stated spread. The Fisher information of pose and joints is the sum of both; by Cramer and Rao no
unbiased estimate has a smaller covariance than its inverse. The Jacobian is that of the outline at the truth, central
differences of its points on the instrument.

A bound of this model, not a law: errors that are uniform and never beyond half a pixel say more than Gaussian ones of
the same spread, and the median of an error lies below its root mean square, so ratios below one do occur.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from accuracy_calibration import jacobian, shaft_direction, tip_position
from accuracy_cases import Case, Run
from accuracy_errors import frame_errors
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]

PIXEL_SIGMA: Final = 1 / np.sqrt(12)
_STEP: Final = 1e-5  # m and rad


def crossing_rates(body: Body, case: Case, pose: Float64, joints: Float64) -> Float64:
    """How fast each crossing of the outline with a row or column moves along it, px per m or rad, (6 + J, N)."""
    outline = Renderer(body, case.camera, threads=1).outlines(pose[None], joints[None])
    count = 6 + len(joints)
    change = _STEP * np.concatenate([np.eye(count), -np.eye(count)])
    links = body.camera_from_links(moved(pose, change[:, :6]), joints + change[:, 6:])[:, outline.link]
    points = (links[..., :3, :3] @ outline.points[:, :, None])[..., 0] + links[..., :3, 3]
    seen = case.camera.project(points)
    # A normal is as long as the outline between two lines, so this product is the way along the line.
    along = (seen * outline.normals).sum(axis=-1)
    rates = np.asarray((along[:count] - along[count:]) / (2 * _STEP))
    if case.ignore is not None:
        column, row = np.rint(outline.pixels).astype(int).T
        rates = rates[:, ~case.ignore[row, column]]
    return rates


def least_covariance(body: Body, case: Case, config: EstimateConfig) -> Float64:
    """Cramer-Rao bound of the covariance of small changes [t, r, joints] at the truth, (6 + J, 6 + J)."""
    assert case.truth is not None
    names = body.instrument.joint_names
    joints = np.array([case.truth.joints[name] for name in names])
    rates = crossing_rates(body, case, case.truth.camera_from_root, joints)
    information = rates @ rates.T / PIXEL_SIGMA**2
    for k, name in enumerate(names):
        if name in case.readings:
            information[6 + k, 6 + k] += 1 / np.deg2rad(config.readings.of(name)) ** 2
    return np.asarray(np.linalg.inv(information))


def frame_bound(body: Body, run: Run, config: EstimateConfig) -> dict[str, Any]:
    """Errors of a run, their bound, and the ratio: of the tips' root mean square error, mm, and the axis's, deg."""
    instrument, truth = body.instrument, run.case.truth
    assert truth is not None
    covariance = least_covariance(body, run.case, config)
    names = instrument.joint_names
    pose, joints = truth.camera_from_root, np.array([truth.joints[name] for name in names])
    found = np.array([run.joints[name] for name in names])
    row: dict[str, Any] = {"session": run.case.session, "frame": run.case.frame}
    tips = [tip_position(instrument, [k]) for k in range(len(instrument.jaw_tips))]
    axis = shaft_direction(instrument, pose)
    for name, unit, group in (("tip_mm", 1e3, tips), ("axis_deg", np.degrees(1.0), [axis])):
        if not group:
            continue
        squared = [((q(run.pose[None], found[None]) - q(pose[None], joints[None])) ** 2).sum() for q in group]
        slopes = [jacobian(q, pose, joints) for q in group]
        least = [np.trace(slope @ covariance @ slope.T) for slope in slopes]
        error, bound = np.sqrt(np.mean(squared)), np.sqrt(np.mean(least))
        row[name] = float(unit * error)
        row[f"{name}_bound"] = float(unit * bound)
        row[f"{name.split('_')[0]}_ratio"] = float(error / bound)
    return row


def bound_report(body: Body, runs: Sequence[Run], config: EstimateConfig) -> dict[str, Sequence[dict[str, Any]]]:
    """Rows of all frames in the right mode, and the ratios' medians; ``rms`` is the root mean square ratio."""
    right = [run for run in runs if frame_errors(body.instrument, run).get("right_mode")]
    rows = [frame_bound(body, run, config) for run in right]
    overall = []
    for name in ("tip_ratio", "axis_ratio"):
        ratios = np.array([row[name] for row in rows if name in row])
        if len(ratios):
            overall.append(
                {
                    "ratio": name,
                    "frames": len(ratios),
                    "median": float(np.median(ratios)),
                    "90 %": float(np.percentile(ratios, 90)),
                    "rms": float(np.sqrt(np.mean(ratios**2))),
                }
            )
    return {"measured error / bound, by frame": rows, "measured error / bound": overall}
