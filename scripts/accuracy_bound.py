"""The smallest errors that an exact mask on a pixel grid allows, and how near to them the estimates come.

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
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from accuracy_calibration import jacobian, shaft_direction, tip_position
from accuracy_cases import Case, Run, by_level
from accuracy_errors import frame_errors
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]

PIXEL_SIGMA: Final = 1 / np.sqrt(12)
_STEP: Final = 1e-5  # m and rad


@dataclass(frozen=True, eq=False)
class Crossings:
    """Where the outline of a pose crosses rows (where it is steep) and columns (where it is flat), N places.

    ``rates`` (6 + J, N): how fast each moves along its row or column, px per m or rad. ``lengths`` (N,): px of outline
    from one to the next; a step along the line is so many times as long as one across the outline. ``pixels`` (N, 2).
    """

    rates: Float64
    lengths: Float64
    pixels: Float64


def find_crossings(body: Body, case: Case, pose: Float64, joints: Float64) -> Crossings:
    """Find the crossings of the outline with rows and columns, without those that are ignored."""
    outline = Renderer(body, case.camera, threads=1).outlines(pose[None], joints[None])
    count = 6 + len(joints)
    change = _STEP * np.concatenate([np.eye(count), -np.eye(count)])
    links = body.camera_from_links(moved(pose, change[:, :6]), joints + change[:, 6:])[:, outline.link]
    points = (links[..., :3, :3] @ outline.points[:, :, None])[..., 0] + links[..., :3, 3]
    seen = case.camera.project(points)
    # A normal is as long as the outline between two lines, so this product is the way along the line.
    along = (seen * outline.normals).sum(axis=-1)
    rates = np.asarray((along[:count] - along[count:]) / (2 * _STEP))
    counts = np.ones(len(outline.pixels), dtype=np.bool_)
    if case.ignore is not None:
        column, row = np.rint(outline.pixels).astype(int).T
        counts = ~case.ignore[row, column]
    lengths = np.linalg.norm(outline.normals, axis=1)
    return Crossings(rates[:, counts], lengths[counts], outline.pixels[counts])


def true_joints(body: Body, case: Case) -> Float64:
    """Give the true values (J,) of the joints that are sought, rad."""
    assert case.truth is not None
    return np.array([case.truth.joints[name] for name in body.instrument.joint_names])


def reading_information(body: Body, case: Case, config: EstimateConfig) -> Float64:
    """Fisher information (6 + J, 6 + J) that a case's readings hold."""
    names = body.instrument.joint_names
    spread = [np.deg2rad(config.readings.of(name)) if name in case.readings else np.inf for name in names]
    return np.diag(1 / np.array([np.inf] * 6 + spread) ** 2)


def least_covariance(body: Body, case: Case, config: EstimateConfig) -> Float64:
    """Cramer-Rao bound of the covariance of small changes [t, r, joints] at the truth, (6 + J, 6 + J)."""
    assert case.truth is not None
    rates = find_crossings(body, case, case.truth.camera_from_root, true_joints(body, case)).rates
    information = rates @ rates.T / PIXEL_SIGMA**2 + reading_information(body, case, config)
    return np.asarray(np.linalg.inv(information))


def frame_bound(body: Body, run: Run, config: EstimateConfig) -> dict[str, Any]:
    """Errors of a run, their bound, and the ratio: of the tips' root mean square error, mm, and the axis's, deg."""
    instrument, truth = body.instrument, run.case.truth
    assert truth is not None
    covariance = least_covariance(body, run.case, config)
    names = instrument.joint_names
    pose, joints = truth.camera_from_root, true_joints(body, run.case)
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
    """Rows of all frames in the right mode, and of each level the ratios' medians and root mean squares."""
    right = [run for run in runs if frame_errors(body.instrument, run).get("right_mode")]
    rows = {run: frame_bound(body, run, config) for run in right}
    overall = []
    for level, group in by_level(right).items():
        for name in ("tip_ratio", "axis_ratio"):
            ratios = np.array([rows[run][name] for run in group if name in rows[run]])
            if len(ratios):
                overall.append(
                    {
                        "level": level,
                        "ratio": name,
                        "frames": len(ratios),
                        "median": float(np.median(ratios)),
                        "90 %": float(np.percentile(ratios, 90)),
                        "rms": float(np.sqrt(np.mean(ratios**2))),
                    }
                )
    return {
        "measured error / bound of the pixel grid, by frame": list(rows.values()),
        "measured error / bound of the pixel grid": overall,
    }
