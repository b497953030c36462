"""Cramer-Rao bound of the errors for masks with correlated noise, and the expected scatter of a session's frames.

The remote centre of motion (RCM) computed from a single frame has an error of millimetres: the tilt of the shaft
towards the camera is determined only by the convergence of its two short edges, and the distance to the RCM is large.
The expected scatter over the frames is simulated. The error of each frame is drawn from the Cramer-Rao bound of its
covariance for the noise of its own mask, which is described by the standard deviation of the contour about the true
silhouette and by the correlation length. These errors are added to the true poses, and the scatter is computed as for
the estimates, with the insertions as read, so that the errors of these readings are included.

Two models of the noise; the weights of the program follow the first one:

- ``blocks``: each correlation length of outline is one measurement with one common error;
- ``smooth``: errors at a distance of d px have the correlation exp(-pi (d / length)^2), and each row or column adds the
  error of the pixel grid. This bound holds for an estimator with the exact correlation as input. Such an estimator
  resolves shapes of the outline that vary more rapidly than the noise, even if they are smaller than the noise.

Both models assume Gaussian errors. The errors of a good mask are not Gaussian: most of the outline is exact to a pixel,
and a few stretches deviate. A robust estimate can therefore have smaller errors than both bounds.

Without truth, the covariances are those of the results, and the poses are the results shifted so that all RCMs agree.
The comparison then shows whether the scatter agrees with these covariances, and not how small it could be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.evaluate.consistency import LEAST_FRAMES, converge_shafts, rcm_spread
from dvrk_cmaes.evidence.outline_noise import OutlineNoise, measure_noise, sampled, signed_distance
from dvrk_cmaes.evidence.shaft_edges import find_contour
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.pose.expected_error import jacobian, tip_position
from dvrk_cmaes.silhouette import Body, Renderer
from measure.accuracy.bound import PIXEL_SIGMA, find_crossings, reading_information
from measure.accuracy.errors import frame_errors
from measure.cases import Case, Run, by_session

Float64 = NDArray[np.float64]

MODELS: Final = ("blocks", "smooth")
DRAWS: Final = 200
_BEYOND: Final = 3.0  # standard deviations from the contour; beyond, the mask does not show the true outline
_LEAST_SHARE: Final = 0.1  # least share of the noise's variance that is correlated, after subtraction of the grid's


@dataclass(frozen=True, eq=False)
class MaskBound:
    """Bounds (6 + J, 6 + J) of the covariance at the truth by model of the noise, and the noise of the mask."""

    covariances: Mapping[str, Float64]
    noise: OutlineNoise


def mask_bound(body: Body, case: Case, config: EstimateConfig) -> MaskBound:
    """Compute the bounds of a case with known truth for the noise of its mask."""
    true = case.true(body.instrument)
    silhouette = Renderer(body, case.camera, threads=1).masks(true.pose[None], true.joints[None])[0]
    noise = measure_noise(find_contour(case.mask, case.camera, case.ignore), silhouette)
    crossings = find_crossings(body, case, true)
    off = sampled(signed_distance(case.mask), crossings.pixels)
    visible = np.abs(off) < _BEYOND * max(noise.sigma, 0.5)
    lengths, pixels = crossings.lengths[visible], crossings.pixels[visible]
    rates = crossings.rates[:, visible] / lengths  # perpendicular to the outline
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
    """Return the scatter, mm, of poses (N, 4, 4) with insertion readings (N,), m.

    ``sigma_mm`` is the standard deviation of the distances of the axes from the point nearest to all of them;
    ``rcm_mm`` is the root mean square distance of the frames' RCMs from their mean.
    """
    return {"sigma_mm": 1e3 * converge_shafts(poses).sigma, "rcm_mm": 1e3 * rcm_spread(poses, insertion).rms}


def with_common_rcm(poses: Float64, insertion: Float64) -> Float64:
    """Shift poses (N, 4, 4) so that all RCMs, computed with the insertions (N,), are equal to their mean."""
    found = rcm_spread(poses, insertion)
    shifted = poses.copy()
    shifted[:, :3, 3] += found.centre - found.points
    return shifted


def drawn_spreads(
    poses: Float64, insertion: Float64, covariances: Float64, *, draws: int = DRAWS, seed: int = 0
) -> dict[str, Float64]:
    """Return the scatter (draws,) of poses (N, 4, 4) plus random errors of covariances (N, 6 + J, 6 + J)."""
    rng = np.random.default_rng(seed)
    roots = np.linalg.cholesky(covariances[:, :6, :6])
    errors = np.einsum("nij,dnj->dni", roots, rng.standard_normal((draws, len(poses), 6)))
    rows = [spreads(moved(poses, error), insertion) for error in errors]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@dataclass(frozen=True, eq=False)
class BoundedRuns:
    """Runs of one session with a pose; if the truth is ``known``, only those in the right mode, with their bounds."""

    runs: Sequence[Run]
    known: bool
    bounds: Sequence[MaskBound]

    def covariances(self, model: str) -> Float64:
        """Return the bounds (N, 6 + J, 6 + J) of all frames by one model."""
        return np.stack([bound.covariances[model] for bound in self.bounds])


def bound_runs(body: Body, runs: Sequence[Run], config: EstimateConfig) -> BoundedRuns:
    """Compute the bounds of one session's runs."""
    posed = [run for run in runs if not run.failed]
    if any(run.case.truth is None for run in posed):
        return BoundedRuns(posed, known=False, bounds=())
    right = [run for run in posed if frame_errors(body.instrument, run)["right_mode"]]
    return BoundedRuns(right, known=True, bounds=[mask_bound(body, run.case, config) for run in right])


def spread_rows(runs: Sequence[Run], bounded: BoundedRuns) -> list[dict[str, Any]]:
    """Return the measured and expected scatter of one session's frames, one row for each model of the noise.

    There are no rows with fewer than three frames or without insertion readings. ``_expected`` is the mean over the
    draws and ``_5_95`` their 5th and 95th percentile; ``ratio`` is measured over expected. ``rcm_mm_all`` is that of
    all ``runs`` with a pose, in any mode; ``rcm_mm_read`` that of the true poses, from the errors of the insertion
    readings alone; ``outline_px`` and ``length_px`` are the medians of the masks' noise and correlation length.
    """
    used = bounded.runs
    if len(used) < LEAST_FRAMES or any("insertion" not in run.case.readings for run in runs):
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
        centre, models = with_common_rcm(found, insertion), {"results' own": np.stack([run.covariance for run in used])}
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


def tip_rows(body: Body, bounded: BoundedRuns) -> list[dict[str, Any]]:
    """Return the root mean square error of one session's jaw tips, mm, and its bound, one row for each model."""
    instrument = body.instrument
    if not bounded.bounds or not instrument.jaw_tips:
        return []
    squared: list[float] = []
    variances: dict[str, list[float]] = {model: [] for model in MODELS}
    for run, bound in zip(bounded.runs, bounded.bounds, strict=True):
        true, found = run.case.true(instrument), run.at(instrument)
        for k in range(len(instrument.jaw_tips)):
            tip = tip_position(instrument, [k])
            squared.append(float(((tip(found[None]) - tip(true[None])) ** 2).sum()))
            slope = jacobian(tip, true)
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
    """Compare measured and expected scatter, and errors of the tips with their bounds, for all sessions."""
    sessions = by_session(runs)
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
    """Stack the poses of runs, (N, 4, 4)."""
    return np.stack([run.pose for run in runs])


def _insertion(runs: Sequence[Run]) -> Float64:
    """Return the insertion readings of runs, (N,) m."""
    return np.array([run.case.readings["insertion"] for run in runs], dtype=np.float64)
