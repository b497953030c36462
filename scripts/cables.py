"""Fit the errors of cable-driven joints to recordings of a real arm's commanded and measured joints.

    python scripts/cables.py RECORDING.npz...           what each part of the model buys, fitted on the first half
    python scripts/cables.py RECORDING.npz... --write   fit whole recordings and write data/cables/measured.json

To be run by hand. A recording has ``time`` (N,), s, and ``commanded`` and ``measured`` (N, 6): yaw, pitch (rad),
insertion (m), roll, wrist_pitch, wrist_yaw (rad), in the order of time. Commanded positions are taken for readings and
measured ones for the truth. Poses without a measurement (roll, wrist_pitch and wrist_yaw exactly zero) do not count,
unless --all is given. The model is that of `dvrk_cmaes.joints.cables`; each of its parts is fitted on the first half of
a recording, and predicts the errors of the second half from readings alone. Likelihoods are of the second half, in
nats a pose; that of the wander uses the errors of earlier poses, too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from committed_data import refuse_in_ci
from measuring.report import show
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize

from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.joints.cables import CableModel, features
from dvrk_cmaes.joints.play import play_of

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

JOINTS: Final = ("roll", "wrist_pitch", "wrist_yaw")
PARTS: Final = ("offset", "coupling", "play", "drag")
"""Parts of the model that predict from readings alone; each is added to those before it."""

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

    @property
    def halves(self) -> tuple[Bool, Bool]:
        """The measured poses (N,) of the first and of the second half."""
        first = np.arange(len(self.time)) < len(self.time) // 2
        return self.has & first, self.has & ~first


def fit(recording: Recording, used: Bool, parts: Sequence[str]) -> CableModel:
    """Fit the parts of the model, except for the wander, to the errors of some poses (N,)."""
    widths = np.deg2rad(_WIDTHS_DEG)
    if "play" in parts:

        def cost(factors: Float64) -> float:
            found = _fit_with_widths(recording, used, parts, widths * np.exp(factors))
            return float(np.log(found.noise).sum())

        best = minimize(cost, np.zeros(3), method="Nelder-Mead", options={"maxfev": _WIDTH_STEPS})
        widths = widths * np.exp(best.x)
    return _fit_with_widths(recording, used, parts, widths)


def _fit_with_widths(recording: Recording, used: Bool, parts: Sequence[str], widths: Float64) -> CableModel:
    """Fit offsets and coefficients for given widths (3,), by least squares with a robust loss."""
    count = len(JOINTS)
    reference = recording.readings[used].mean(axis=0)
    terms = features(recording.readings, play_of(recording.readings, widths), reference)[used]
    own = np.eye(count, dtype=np.bool_)
    kept = np.concatenate(
        [np.full((count, count), "coupling" in parts), np.zeros((count, count + 1), np.bool_)], axis=1
    )
    kept[:, count : 2 * count] = (own & ("play" in parts)) | (~own & ("drag" in parts))
    kept[:, -1] = "play" in parts
    offset, coefficients, noise = np.zeros(count), np.zeros((count, 2 * count + 1)), np.zeros(count)
    for j in range(count):
        design = np.column_stack([np.ones(used.sum()), terms[:, j, kept[j]]])
        found = _robust_line(design, recording.errors[used, j])
        offset[j], coefficients[j, kept[j]] = found[0], found[1:]
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


def residuals(recording: Recording, model: CableModel) -> Float64:
    """Return the errors (N, 3) that a model does not explain from the readings alone, rad."""
    return np.asarray(recording.errors - model.errors(recording.readings, play_of(recording.readings, model.width)))


def with_wander(recording: Recording, used: Bool, model: CableModel) -> CableModel:
    """Add the wander with the greatest likelihood of what a model leaves of the errors of some poses (N,)."""
    left = residuals(recording, model)[used]
    found = np.array([_fit_wander(recording.time[used], column) for column in left.T])
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


def report(recording: Recording) -> tuple[list[dict[str, Any]], CableModel]:
    """Return what each part of the model, fitted on the first half, buys in the second half, and the whole model."""
    first, second = recording.halves
    rows = []
    for count in range(1, len(PARTS) + 1):
        model = fit(recording, first, PARTS[:count])
        left = residuals(recording, model)[second]
        likelihood = -0.5 * np.mean(left**2 / model.noise**2 + np.log(2 * np.pi * model.noise**2), axis=0)
        rows.append({"model": f"+ {PARTS[count - 1]}" if count > 1 else PARTS[0]} | _row(left, likelihood))
    model = with_wander(recording, first, model)
    likelihood = np.array(
        [
            wander_log_likelihood(recording.time[second], left[:, j], *_wander_of(model, j)).mean()
            for j in range(len(JOINTS))
        ]
    )
    return [*rows, {"model": "+ wander"} | _row(left, likelihood)], model


def _row(left: Float64, likelihood: Float64) -> dict[str, Any]:
    """Return the root mean square of errors (N, 3), deg, and their log-likelihood (3,) by joint."""
    rms = np.degrees(np.sqrt(np.mean(left**2, axis=0)))
    return {f"{name}, deg": float(value) for name, value in zip(JOINTS, rms, strict=True)} | {
        f"{name}, nats": float(value) for name, value in zip(JOINTS, likelihood, strict=True)
    }


def _wander_of(model: CableModel, joint: int) -> tuple[float, float, float]:
    return float(model.wander[joint]), float(model.seconds[joint]), float(model.noise[joint])


def parameters(model: CableModel) -> list[dict[str, Any]]:
    """Return the parameters of a model by joint; angles in degrees, coefficients in rad a rad."""
    return [
        {
            "joint": name,
            "offset": float(np.degrees(model.offset[j])),
            **{f"coupling to {other}": float(model.coupling[j, k]) for k, other in enumerate(JOINTS)},
            **{f"play of {other}": float(model.play[j, k]) for k, other in enumerate(JOINTS)},
            "narrow play": float(model.narrow[j]),
            "width": float(np.degrees(model.width[j])),
            "wander": float(np.degrees(model.wander[j])),
            "wander, s": float(model.seconds[j]),
            "noise": float(np.degrees(model.noise[j])),
        }
        for j, name in enumerate(JOINTS)
    ]


def describe_fit(recording: Recording) -> dict[str, Any]:
    """Fit a whole recording and return the parameters for data/cables/measured.json."""
    model = with_wander(recording, recording.has, fit(recording, recording.has, PARTS))

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
    """Print what each part buys, or write the fits; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING.npz", help="recordings of an arm")
    parser.add_argument("--all", action="store_true", help="count poses without a measurement as measured at zero")
    parser.add_argument("--write", action="store_true", help="write data/cables/measured.json")
    options = parser.parse_args(arguments)
    recordings = [Recording.read(path, every_pose=options.all) for path in options.recordings]
    if options.write:
        refuse_in_ci("data/cables/measured.json")
        write_json(bundled_path("cables", "measured.json"), {"fits": [describe_fit(one) for one in recordings]})
        return 0
    for one in recordings:
        rows, model = report(one)
        show(f"{one.name}: {int(one.has.sum())} of {len(one.time)} poses, errors of the second half", rows)
        show(f"{one.name}: parameters, first half", parameters(model))
    return 0


if __name__ == "__main__":
    sys.exit(main())
