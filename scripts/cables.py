"""Fit the errors of cable-driven joints to recordings of a real arm's commanded and measured joints.

    python scripts/cables.py RECORDING.npz...           print the fits
    python scripts/cables.py RECORDING.npz... --write   write them to data/cables/measured.json

To be run by hand. A recording has ``time`` (N,), s, and ``commanded`` and ``measured`` (N, 6): yaw, pitch (rad),
insertion (m), roll, wrist_pitch, wrist_yaw (rad), in the order of time. Commanded positions are taken for readings and
measured ones for the truth. Poses without a measurement (roll, wrist_pitch and wrist_yaw exactly zero) do not count,
unless --all is given. The model is that of
`dvrk_cmaes.joints.cable_prior`. What each of its parts predicts of the second
half of a recording, fitted on the first, is in data/measurements.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from committed_data import refuse_in_ci
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.joints.cable_prior import CableModel, features, play_of

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

JOINTS: Final = ("roll", "wrist_pitch", "wrist_yaw")

_COLUMNS = slice(3, 6)  # of the joints in a recording
_WIDTHS_DEG = (1.5, 10.0, 16.0)  # at the start of the search
_ROBUST_DEG = 6.0  # scale of the robust loss of the fit
_LEAST_NOISE = np.deg2rad(0.05)
_WIDTH_STEPS = 100  # evaluations of the search for the widths


@dataclass(frozen=True, eq=False)
class Recording:
    """Readings and errors (N, 3) of roll, wrist_pitch and wrist_yaw, rad, at times (N,), s; ``has`` marks measured."""

    name: str
    time: Float64
    readings: Float64
    errors: Float64
    has: Bool

    @classmethod
    def read(cls, path: Path, *, every_pose: bool = False) -> Recording:
        """Read a recording; with ``every_pose``, those without a measurement count as measured at zero."""
        with np.load(path) as data:
            commanded, measured = data["commanded"][:, _COLUMNS], data["measured"][:, _COLUMNS]
            has = (measured != 0).any(axis=1) | every_pose
            return cls(path.stem, data["time"], commanded, measured - commanded, has)


def fit(recording: Recording) -> CableModel:
    """Fit the model, except for the wander, to the errors of the measured poses."""
    widths = np.deg2rad(_WIDTHS_DEG)

    def cost(factors: Float64) -> float:
        return float(np.log(_fit_with_widths(recording, widths * np.exp(factors)).noise).sum())

    best = minimize(cost, np.zeros(3), method="Nelder-Mead", options={"maxfev": _WIDTH_STEPS})
    return _fit_with_widths(recording, widths * np.exp(best.x))


def _fit_with_widths(recording: Recording, widths: Float64) -> CableModel:
    """Fit offsets and coefficients for given widths (3,), by least squares with a robust loss."""
    count, used = len(JOINTS), recording.has
    reference = recording.readings[used].mean(axis=0)
    terms = features(recording.readings, play_of(recording.readings, widths), reference)[used]
    offset, coefficients, noise = np.zeros(count), np.zeros((count, 2 * count + 1)), np.zeros(count)
    for j in range(count):
        design = np.column_stack([np.ones(used.sum()), terms[:, j]])
        found = _robust_line(design, recording.errors[used, j])
        offset[j], coefficients[j] = found[0], found[1:]
        noise[j] = np.sqrt(np.mean((recording.errors[used, j] - design @ found) ** 2))
    coupling, play, narrow = np.split(coefficients, [count, 2 * count], axis=1)
    none = np.zeros(count)
    return CableModel(JOINTS, reference, offset, coupling, play, narrow[:, 0], widths, none, none + 1, noise)


def _robust_line(design: Float64, values: Float64) -> Float64:
    """Return the coefficients (K,) of a design (N, K) that explain values (N,), with a loss that forgives outliers."""
    start = np.linalg.lstsq(design, values, rcond=None)[0]
    found = least_squares(
        lambda x: design @ x - values, start, jac=lambda x: design, loss="soft_l1", f_scale=np.deg2rad(_ROBUST_DEG)
    )
    return np.asarray(found.x)


def with_wander(recording: Recording, model: CableModel) -> CableModel:
    """Add the wander with the greatest likelihood of what a model leaves of the errors of the measured poses."""
    read = model.errors(recording.readings, play_of(recording.readings, model.width))
    left = (recording.errors - read)[recording.has]
    found = np.array([_fit_wander(recording.time[recording.has], column) for column in left.T])
    return replace(model, wander=found[:, 0], seconds=found[:, 1], noise=found[:, 2])


def _fit_wander(time: Float64, values: Float64) -> Float64:
    """Return standard deviation, correlation time, s, and noise (3,) of an Ornstein-Uhlenbeck process in noise."""
    scatter = float(np.std(values))
    start = np.log([scatter, 5.0, 0.3 * scatter])
    found = minimize(lambda x: -wander_log_likelihood(time, values, *np.exp(x)).sum(), start, method="Nelder-Mead")
    std, seconds, noise = np.exp(found.x)
    return np.array([std, seconds, max(noise, _LEAST_NOISE)])


def wander_log_likelihood(time: Float64, values: Float64, std: float, seconds: float, noise: float) -> Float64:
    """Return the log-likelihood (N,) of each value given those before it, by a Kalman filter."""
    mean, variance, found = 0.0, std**2, np.zeros(len(values))
    keep = np.exp(-np.diff(time, prepend=time[0]) / seconds).tolist()
    for k, value in enumerate(values.tolist()):
        mean *= keep[k]
        variance = keep[k] ** 2 * variance + (1 - keep[k] ** 2) * std**2
        total = variance + noise**2
        found[k] = -0.5 * ((value - mean) ** 2 / total + np.log(2 * np.pi * total))
        mean += variance / total * (value - mean)
        variance *= noise**2 / total
    return found


def describe_fit(recording: Recording) -> dict[str, Any]:
    """Fit a whole recording and return the parameters for data/cables/measured.json."""
    model = with_wander(recording, fit(recording))

    def degrees(values: Float64) -> list[float]:
        return [round(float(value), 3) for value in np.degrees(values)]

    return {
        "recording": recording.name,
        "poses": int(recording.has.sum()),
        "joints": list(JOINTS),
        "offset_deg": degrees(model.offset),
        "coupling": model.coupling.round(4).tolist(),
        "play": model.play.round(4).tolist(),
        "narrow": model.narrow.round(4).tolist(),
        "width_deg": degrees(model.width),
        "wander_deg": degrees(model.wander),
        "wander_seconds": [round(float(value), 2) for value in model.seconds],
        "noise_deg": degrees(model.noise),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print or write the fits; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING.npz", help="recordings of an arm")
    parser.add_argument("--all", action="store_true", help="count poses without a measurement as measured at zero")
    parser.add_argument("--write", action="store_true", help="write data/cables/measured.json")
    options = parser.parse_args(arguments)
    fits = [describe_fit(Recording.read(path, every_pose=options.all)) for path in options.recordings]
    if options.write:
        refuse_in_ci("data/cables/measured.json")
        write_json(bundled_path("cables", "measured.json"), {"fits": fits})
    else:
        print(json.dumps({"fits": fits}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
