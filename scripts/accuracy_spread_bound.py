"""The smallest errors that a session's very masks allow, and so the smallest spread of its frames.

Solved alone, a frame places the centre that all shafts turn about with an error of millimetres: a shaft's tilt towards
the camera shows only in how its two short edges converge, and the lever to the centre is long. What to expect is
simulated. Each frame's error is drawn from the smallest covariance that Cramer and Rao allow with the noise that its
own mask has: the contour's spread about the true silhouette and its correlation length. Added to the true poses, these
errors give spreads as the estimates' are measured, with the insertions as read, whose errors so count too.

Two models of the noise, of which the first is the one that the program's own weights follow:

- ``blocks``: each correlation length of outline is one measurement, and all of it is off by as much;
- ``smooth``: errors at d px from each other are correlated by exp(-pi (d / length)^2), and each row or column reads the
  outline to a pixel. It supposes that it is known how the errors hang together: a bend sharper than the noise is then
  seen far better than the noise is large. Nothing that does not know this comes near.

Either takes the errors for Gaussian. Those of a good mask are not: most of its outline is right to the pixel and a few
stretches are one off. An estimate that passes over those can do better than either says.

Where no truth is known, the covariances are the results' own, about their poses shifted so that all centres agree: that
says whether a spread is what the results lead one to expect, not how small it could be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from accuracy_bound import PIXEL_SIGMA, find_crossings, reading_information, true_joints
from accuracy_calibration import jacobian, tip_position
from accuracy_cases import Case, Run
from accuracy_errors import frame_errors
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evaluate.consistency import FEWEST, converge_shafts, rcm_spread
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise, sampled, signed_distance
from dvrk_cmaes.evidence.shaft_edges import find_contour
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.silhouette import Body, Renderer

Float64 = NDArray[np.float64]

MODELS: Final = ("blocks", "smooth")
DRAWS: Final = 200
_BEYOND: Final = 3.0  # standard deviations from the mask's outline, where the true one is not what the mask shows
_LEAST_SHARE: Final = 0.1  # of the noise's variance that is smooth, whatever the grid accounts for


@dataclass(frozen=True, eq=False)
class MaskBound:
    """Bounds (6 + J, 6 + J) of the covariance at the truth, by the model of the noise, and the noise of the mask."""

    covariances: Mapping[str, Float64]
    noise: OutlineNoise


def mask_bound(body: Body, case: Case, config: EstimateConfig) -> MaskBound:
    """Find the bounds of one case, whose truth is known, with the noise that its mask has."""
    assert case.truth is not None
    pose, joints = case.truth.camera_from_root, true_joints(body, case)
    silhouette = Renderer(body, case.camera, threads=1).masks(pose[None], joints[None])[0]
    noise = measure_noise(find_contour(case.mask, case.camera, case.ignore), silhouette)
    crossings = find_crossings(body, case, pose, joints)
    off = sampled(signed_distance(case.mask), crossings.pixels)
    shown = np.abs(off) < _BEYOND * max(noise.sigma, 0.5)
    lengths, pixels = crossings.lengths[shown], crossings.pixels[shown]
    rates = crossings.rates[:, shown] / lengths  # across the outline
    grid = PIXEL_SIGMA**2 / lengths**2
    smooth = max(noise.sigma**2 - float(grid.mean()), _LEAST_SHARE * noise.sigma**2)
    errors = smooth * np.exp(-np.pi * (cdist(pixels, pixels) / noise.length) ** 2) + np.diag(grid)
    information = {
        "blocks": (rates * lengths) @ rates.T / (noise.sigma**2 * noise.length),
        "smooth": rates @ np.linalg.solve(errors, rates.T),
    }
    readings = reading_information(body, case, config)
    return MaskBound({name: np.asarray(np.linalg.inv(part + readings)) for name, part in information.items()}, noise)


def spreads(poses: Float64, insertion: Float64) -> dict[str, float]:
    """Spreads of poses (N, 4, 4) with the insertions read, (N,) m, in mm.

    ``sigma_mm``: standard deviation of the distances from the axes to the point nearest to all; ``rcm_mm``: root mean
    square distance of the frames' centres of motion from their mean.
    """
    return {"sigma_mm": 1e3 * converge_shafts(poses).sigma, "rcm_mm": 1e3 * rcm_spread(poses, insertion).rms}


def agreeing(poses: Float64, insertion: Float64) -> Float64:
    """Shift poses (N, 4, 4) so that each gives, with the insertions (N,), the mean centre of motion of all."""
    found = rcm_spread(poses, insertion)
    shifted = poses.copy()
    shifted[:, :3, 3] += found.centre - found.points
    return shifted


def drawn_spreads(
    poses: Float64, insertion: Float64, covariances: Float64, *, draws: int = DRAWS, seed: int = 0
) -> dict[str, Float64]:
    """Spreads (draws,) of poses (N, 4, 4) with errors of covariances (N, 6 + J, 6 + J) of [t, r, joints] added."""
    rng = np.random.default_rng(seed)
    roots = np.linalg.cholesky(covariances[:, :6, :6])
    errors = np.einsum("nij,dnj->dni", roots, rng.standard_normal((draws, len(poses), 6)))
    rows = [spreads(moved(poses, error), insertion) for error in errors]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@dataclass(frozen=True, eq=False)
class Bounded:
    """Runs of one session that have a pose, in the right mode where the truth is ``known``, and then their bounds."""

    runs: Sequence[Run]
    known: bool
    bounds: Sequence[MaskBound]

    def covariances(self, model: str) -> Float64:
        """Bounds of all frames by one model, (N, 6 + J, 6 + J)."""
        return np.stack([bound.covariances[model] for bound in self.bounds])


def bound_runs(body: Body, runs: Sequence[Run], config: EstimateConfig) -> Bounded:
    """Find the bounds of one session's runs."""
    posed = [run for run in runs if not run.failed]
    if any(run.case.truth is None for run in posed):
        return Bounded(posed, known=False, bounds=())
    right = [run for run in posed if frame_errors(body.instrument, run)["right_mode"]]
    return Bounded(right, known=True, bounds=[mask_bound(body, run.case, config) for run in right])


def spread_rows(runs: Sequence[Run], bounded: Bounded) -> list[dict[str, Any]]:
    """Spreads of one session's frames, measured and expected: a row for each model; none without insertions.

    ``_expected`` is the mean over the draws and ``_5_95`` their range; ``ratio`` is measured over expected.
    ``rcm_mm_all`` is that of all ``runs`` that have a pose, whatever their mode; ``rcm_mm_read`` what the insertions'
    errors alone make of the true poses; ``outline_px`` and ``length_px`` the masks' noise, in the median.
    """
    used = bounded.runs
    if len(used) < FEWEST or any("insertion" not in run.case.readings for run in runs):
        return []
    posed = [run for run in runs if not run.failed]
    found, insertion = _poses(used), _insertion(used)
    measured = spreads(found, insertion)
    whole = {"rcm_mm_all": spreads(_poses(posed), _insertion(posed))["rcm_mm"]}
    if bounded.known:
        centre = np.stack([run.case.truth.camera_from_root for run in used if run.case.truth is not None])
        models = {name: bounded.covariances(name) for name in MODELS}
        whole["rcm_mm_read"] = spreads(centre, insertion)["rcm_mm"]
        whole["outline_px"] = float(np.median([bound.noise.sigma for bound in bounded.bounds]))
        whole["length_px"] = float(np.median([bound.noise.length for bound in bounded.bounds]))
    else:
        centre, models = agreeing(found, insertion), {"results' own": np.stack([run.covariance for run in used])}
    rows = []
    for model, covariances in models.items():
        drawn = drawn_spreads(centre, insertion, covariances)
        row: dict[str, Any] = {"session": runs[0].case.session, "expected of": model, "frames": len(used)}
        for name, value in measured.items():
            expected = float(drawn[name].mean())
            row |= {
                name: value,
                f"{name}_expected": expected,
                f"{name}_5_95": [float(np.percentile(drawn[name], p)) for p in (5, 95)],
                f"{name.removesuffix('_mm')}_ratio": value / expected,
            }
        rows.append(row | whole)
    return rows


def tip_rows(body: Body, bounded: Bounded) -> list[dict[str, Any]]:
    """Root mean square error of one session's jaw tips, mm, and the smallest: a row for each model."""
    instrument = body.instrument
    if not bounded.bounds or not instrument.jaw_tips:
        return []
    squared: list[float] = []
    variances: dict[str, list[float]] = {model: [] for model in MODELS}
    for run, bound in zip(bounded.runs, bounded.bounds, strict=True):
        assert run.case.truth is not None
        pose, joints = run.case.truth.camera_from_root, true_joints(body, run.case)
        found = np.array([run.joints[name] for name in instrument.joint_names])
        for k in range(len(instrument.jaw_tips)):
            tip = tip_position(instrument, [k])
            squared.append(float(((tip(run.pose[None], found[None]) - tip(pose[None], joints[None])) ** 2).sum()))
            slope = jacobian(tip, pose, joints)
            for model in MODELS:
                variances[model].append(float(np.trace(slope @ bound.covariances[model] @ slope.T)))
    error = 1e3 * float(np.sqrt(np.mean(squared)))
    rows = []
    for model in MODELS:
        least = 1e3 * float(np.sqrt(np.mean(variances[model])))
        names = {"session": bounded.runs[0].case.session, "least of": model, "frames": len(bounded.runs)}
        rows.append({**names, "tip_mm_rms": error, "tip_mm_least": least, "ratio": error / least})
    return rows


def mask_report(body: Body, runs: Sequence[Run], config: EstimateConfig) -> dict[str, Sequence[dict[str, Any]]]:
    """Spreads and tips of all sessions, measured and expected."""
    sessions: dict[str, list[Run]] = {}
    for run in runs:
        sessions.setdefault(run.case.session, []).append(run)
    bounded = {name: bound_runs(body, group, config) for name, group in sessions.items()}
    return {
        "spread over a session's frames, measured and expected": [
            row for name, group in sessions.items() for row in spread_rows(group, bounded[name])
        ],
        "error of the tips, measured and least for these masks": [
            row for one in bounded.values() for row in tip_rows(body, one)
        ],
    }


def _poses(runs: Sequence[Run]) -> Float64:
    return np.stack([run.pose for run in runs])


def _insertion(runs: Sequence[Run]) -> Float64:
    return np.array([run.case.readings["insertion"] for run in runs], dtype=np.float64)
