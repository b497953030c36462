"""Expected errors of the jaw tips and of the shaft's direction, propagated from the covariance of a pose.

The covariance of a pose is that of small changes [t, r, joints]. Jacobians from central differences carry it to points
in the camera's frame. The distance within which a point lies with 90 % is that of a gamma distribution with the mean
and the variance of the squared distance (Satterthwaite's approximation).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float64, Posed, apply, frame_along
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import ExpectedError

Quantity = Callable[[Posed], Float64]
"""Function of C poses with values (C, n)."""
Points = tuple[Float64, ...]

INTERVAL = 0.9
"""Probability of the distance ``tip_90_mm``."""

_STEP = 1e-5  # m and rad
_NORMAL = 1.2815515655446004  # quantile ``INTERVAL`` of the standard normal distribution
_ITERATIONS = 20  # of Newton's method, which needs four


def jacobian(quantity: Quantity, at: Posed) -> Float64:
    """Return the derivatives (n, 6 + J) of a quantity by small changes [t, r, joints], from central differences."""
    return _slope(quantity(_moved(at)))


def _moved(at: Posed) -> Posed:
    """Return one pose after each of the small changes, first forwards, then backwards, (2 (6 + J),)."""
    count = 6 + len(at.joints)
    return at.moved(_STEP * np.concatenate([np.eye(count), -np.eye(count)]))


def _slope(values: Float64) -> Float64:
    """Return the derivatives (n, D) of a quantity from its values (2 D, n) at the poses of `_moved`."""
    count = len(values) // 2
    return np.asarray((values[:count] - values[count:]).T / (2 * _STEP))


def _position(pose: Float64, ends: Float64, which: Sequence[int]) -> Float64:
    """Return the mean position (C, 3) m in the camera of some of the tips, whose places (C, K, 3) are in the root."""
    tips = ends[:, list(which)].mean(axis=1)
    return np.asarray(np.einsum("nij,nj->ni", pose[:, :3, :3], tips) + pose[:, :3, 3])


def shaft_direction(instrument: Instrument, about: Float64) -> Quantity:
    """Return the quantity: the two components (C, 2) of the shaft's direction across that of the pose ``about``."""
    along = np.array([0.0, 0.0, 1.0]) if instrument.shaft is None else instrument.shaft.direction
    across = frame_along(about[:3, :3] @ along)[:, :2]
    return lambda at: np.asarray(at.pose[:, :3, :3] @ along @ across)


def largest_distance(covariance: Float64) -> float:
    """Return the distance within which a point with a covariance (3, 3) lies with 90 %, in the covariance's unit."""
    mean = float(np.trace(covariance))
    if mean <= 0:
        return 0.0
    variance = 2 * float((covariance**2).sum())
    return float(np.sqrt(_gamma_quantile(mean**2 / variance) * (variance / mean)))


def _gamma_quantile(shape: float) -> float:
    """Return the quantile ``INTERVAL`` of the gamma distribution with a shape of about 0.5 to 1.5 and a scale of 1.

    It is that of ``scipy.special``, whose import takes a third of the start of a process: Newton's method on the series
    of the distribution function, from the approximation of Wilson and Hilferty.
    """
    at = shape * (1 - 1 / (9 * shape) + _NORMAL / (3 * math.sqrt(shape))) ** 3
    for _ in range(_ITERATIONS):
        density = math.exp((shape - 1) * math.log(at) - at - math.lgamma(shape))
        term = total = 1 / shape
        count = 0
        while term > 1e-17 * total:
            count += 1
            term *= at / (shape + count)
            total += term
        step = at * total - INTERVAL / density
        at -= step
        if abs(step) < 1e-14 * at:
            break
    return at


def expected_error(
    instrument: Instrument, at: Posed, covariance: Float64, of_camera: Float64 | None = None
) -> ExpectedError:
    """Propagate the covariance (6 + J, 6 + J) of the small changes of one pose to tips and shaft.

    ``of_camera`` (6 + J, 6 + J) is added to it for the errors in metres: what errors of the camera do to the pose.
    """
    whole = covariance if of_camera is None else covariance + of_camera
    count, moved = len(instrument.ends(at.joints)), _moved(at)
    ends = instrument.ends(moved.joints)
    names = {f"jaw_{k + 1}": [k] for k in range(count)} | {"mean": [*range(count)]} if count > 1 else {"tip": [0]}
    slopes = {name: _slope(_position(moved.pose, ends, which)) for name, which in names.items()}
    spreads = {name: 1e6 * slope @ whole @ slope.T for name, slope in slopes.items()}
    in_camera = [1e6 * slope @ covariance @ slope.T for slope in slopes.values()]
    slope = np.degrees(_slope(shaft_direction(instrument, at.pose)(moved)))
    return ExpectedError(
        tip_mm={name: float(np.sqrt(np.trace(spread))) for name, spread in spreads.items()},
        tip_axes_mm={name: np.sqrt(np.diag(spread)) for name, spread in spreads.items()},
        tip_90_mm=max(largest_distance(spread) for spread in spreads.values()),
        shaft_deg=float(np.sqrt(np.trace(slope @ whole @ slope.T))),
        tip_90_given_camera_mm=None if of_camera is None else max(largest_distance(spread) for spread in in_camera),
        tip_covariance_mm2=spreads,
    )


def locate_tips(instrument: Instrument, camera: Camera, at: Posed) -> tuple[Points, Points]:
    """Return the tips of one pose: their positions in the camera, (3,) m each, and pixels, (2,) each.

    There are no pixels if a tip is behind the camera.
    """
    points = apply(at.pose, instrument.ends(at.joints))
    return tuple(points), tuple(camera.project(points)) if (points[:, 2] > 0).all() else ()
