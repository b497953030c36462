"""Cramer-Rao bound of the errors for an exact mask on a pixel grid, and ratios of the measured errors to it.

Model: an exact mask shows between which two pixel centres the outline passes, once in each row where the outline is
steep and once in each column where it is flat. This is one measurement of the crossing of the outline with the row or
column. Its error is uniform over a pixel, with standard deviation 1 / sqrt(12) px; it is modelled as Gaussian and
independent of the others. The readings are Gaussian with their standard deviations. The Fisher information of pose and
joints is the sum of both. By the Cramer-Rao inequality no unbiased estimate has a smaller covariance than its inverse.
The Jacobian of the outline at the true pose is computed by central differences of its points on the instrument.

Ratios below one are possible, because the bound holds for Gaussian errors: uniform errors of the same standard
deviation contain more information. In addition, the median of an error is smaller than its root mean square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.expected_error import jacobian, shaft_direction, tip_position
from dvrk_cmaes.silhouette import Body, Renderer
from measure.accuracy.errors import frame_errors
from measure.cases import Case, Run, runs_by_level

Float64 = NDArray[np.float64]

PIXEL_SIGMA: Final = 1 / np.sqrt(12)
_STEP: Final = 1e-5  # m and rad


@dataclass(frozen=True, eq=False)
class Crossings:
    """The N crossings of an outline with rows (where it is steep) and columns (where it is flat).

    ``rates`` (6 + J, N) are the derivatives of the positions along the row or column, px per m or rad. ``lengths`` (N,)
    are the lengths of outline between crossings, px; a displacement along the row or column is ``lengths`` times as
    long as one perpendicular to the outline. ``pixels`` (N, 2) are the positions.
    """

    rates: Float64
    lengths: Float64
    pixels: Float64


def find_crossings(body: Body, case: Case, at: Posed) -> Crossings:
    """Find the crossings of the outline at a pose with rows and columns, except at ignored pixels."""
    (outline,) = Renderer(body, case.camera, threads=1).outlines(at.pose[None], at.joints[None])
    count = 6 + len(at.joints)
    change = _STEP * np.concatenate([np.eye(count), -np.eye(count)])
    there = at.moved(change)
    links = body.camera_from_links(there.pose, there.joints)[:, outline.link]
    points = (links[..., :3, :3] @ outline.points[:, :, None])[..., 0] + links[..., :3, 3]
    seen = case.camera.project(points)
    # The length of a normal is that of the outline between two lines: the product is the position along the line.
    along = (seen * outline.normals).sum(axis=-1)
    rates = np.asarray((along[:count] - along[count:]) / (2 * _STEP))
    counts = np.ones(len(outline.pixels), dtype=np.bool_)
    if case.ignore is not None:
        column, row = np.rint(outline.pixels).astype(int).T
        counts = ~case.ignore[row, column]
    lengths = np.linalg.norm(outline.normals, axis=1)
    return Crossings(rates[:, counts], lengths[counts], outline.pixels[counts])


def reading_information(body: Body, case: Case, config: EstimateConfig) -> Float64:
    """Return the Fisher information (6 + J, 6 + J) of a case's readings."""
    names = body.instrument.joint_names
    sigma = [np.deg2rad(config.readings.of(name)) if name in case.readings else np.inf for name in names]
    return np.diag(1 / np.array([np.inf] * 6 + sigma) ** 2)


def least_covariance(body: Body, case: Case, config: EstimateConfig) -> Float64:
    """Return the Cramer-Rao bound (6 + J, 6 + J) of the covariance of small changes [t, r, joints] at the truth."""
    rates = find_crossings(body, case, case.true(body.instrument)).rates
    information = rates @ rates.T / PIXEL_SIGMA**2 + reading_information(body, case, config)
    return np.asarray(np.linalg.inv(information))


def frame_bound(body: Body, run: Run, config: EstimateConfig) -> dict[str, Any]:
    """Return error, bound and ratio of a run: of the tips (root mean square, mm) and of the shaft's axis (deg)."""
    instrument = body.instrument
    covariance = least_covariance(body, run.case, config)
    true, found = run.case.true(instrument), run.at(instrument)
    row: dict[str, Any] = {"session": run.case.session, "frame": run.case.frame}
    tips = [tip_position(instrument, [k]) for k in range(len(instrument.jaw_tips))]
    axis = shaft_direction(instrument, true.pose)
    for name, unit, group in (("tip_mm", 1e3, tips), ("axis_deg", np.degrees(1.0), [axis])):
        if not group:
            continue
        squared = [((q(found[None]) - q(true[None])) ** 2).sum() for q in group]
        slopes = [jacobian(q, true) for q in group]
        least = [np.trace(slope @ covariance @ slope.T) for slope in slopes]
        error, bound = np.sqrt(np.mean(squared)), np.sqrt(np.mean(least))
        row[name] = float(unit * error)
        row[f"{name}_bound"] = float(unit * bound)
        row[f"{name.split('_')[0]}_ratio"] = float(error / bound)
    return row


def bound_report(body: Body, runs: Sequence[Run], config: EstimateConfig) -> dict[str, Sequence[dict[str, Any]]]:
    """Return rows of all frames in the right mode, and the median and root mean square of the ratios by level."""
    right = [run for run in runs if frame_errors(body.instrument, run).get("right_mode")]
    rows = {run: frame_bound(body, run, config) for run in right}
    overall = []
    for level, group in runs_by_level(right).items():
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
