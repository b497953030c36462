"""What is stated of a pose's error: covariance, expected errors of points, probabilities, the camera file's part.

Covariance: of small changes [t, r, joints] of a frame's best mode and of other modes near it. Where the mask's contour
is far from the silhouette at wrist and jaws, tissue or another tool is in front of them; the errors are then larger
than the outline's noise says.

Points and the shaft's direction: Jacobians from central differences carry the covariance to the camera's frame. The
distance within which a point lies with 90 % is that of a gamma distribution with the mean and the variance of the
squared distance (Satterthwaite's approximation).

Probability of a mode: each has the weight exp(-0.6 score), its score being a negative log-likelihood of outline and
readings. The factor stands for errors that long stretches of a mask's contour share, which scores take for independent.
A mode that the search has not found has the odds (e / 10 mm)^3 against those found, e being the expected error of the
tips: where the outline says little about the pose, a search misses more. The exponent and the 10 mm were fitted to made
frames of the levels medium and hard.

Probability of the tips: that of the right mode times that of tips this near in the right mode, each a logistic
function: of the stated probability of the mode, and of the tips' expected error. The functions are fitted by
`scripts/measure.py estimate --fit`; what they do not know, such as another instrument or camera, is named on the page
on accuracy.

Camera file and instrument's size: six parameters that are relative, so that they are the same for an image of any size
and crop: the logarithm of the focal length, that of fy / fx, the principal point right and down over the focal length,
the first radial coefficient, and the logarithm of the factor on all of the instrument. An outline that is seen stays
where it is in the image, so that a pose moves with the parameters by which it is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import CameraConfig
from dvrk_cmaes.evidence.outline_noise import OutlineNoise
from dvrk_cmaes.geometry import Float64, Indices, Posed, apply, frame_along, rotation_angle
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.sections import plane_basis
from dvrk_cmaes.pose.refine.gauss_newton import Fit
from dvrk_cmaes.pose.search.starts import PoseCandidate
from dvrk_cmaes.results.result import ExpectedError, Quality

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


SAME_MODE = np.deg2rad(30.0)
"""Largest rotation between two poses of one mode, rad."""

_TEMPERED = 0.6  # of 560 made frames with masks of all kinds, 99.8 % of the probabilities above 0.95 are then right
_MISSED_MM, _MISSED_POWER = 10.0, 3.0  # odds of a mode that was not found
_MODE = 0.0, 0.81  # constant, and factor of -log(1 - probability of the mode)
_TIPS = 1.33, 2.64  # constant, and factor of log(distance / expected error)
_LEAST_DOUBT = 1e-4  # probability of a wrong mode; no smaller one was ever checked


def mode_weights(modes: Sequence[PoseCandidate]) -> Float64:
    """Return the share of each mode (M,) in the posterior probability of all that were found."""
    scores = np.array([mode.score for mode in modes])
    weights = np.exp(-_TEMPERED * (scores - scores.min()))
    return np.asarray(weights / weights.sum())


def mode_probability(modes: Sequence[PoseCandidate], expected_mm: float) -> float:
    """Return the probability that the first mode is within 30 degrees of the truth.

    ``expected_mm`` is the expected error of the tips if it is.
    """
    best = modes[0].at.pose
    same = [float(rotation_angle(best, mode.at.pose)) < SAME_MODE for mode in modes]
    share = float(mode_weights(modes)[same].sum())
    missed = (expected_mm / _MISSED_MM) ** _MISSED_POWER
    return float(share / (1 + missed))


def tip_probability(expected_mm: float, within_mm: float, *, of_mode: float = 1.0) -> float:
    """Return the probability that the tips are within ``within_mm`` of their true positions.

    Parameters
    ----------
    expected_mm
        Expected error of the tips in the right mode, mm: of their mean, or of the only tip.
    within_mm
        The distance, mm.
    of_mode
        Stated probability of the mode; 1 where a session's prediction determines it.
    """
    mode = 1.0 if of_mode == 1 else _logistic(_MODE[0] - _MODE[1] * math.log(max(1 - of_mode, _LEAST_DOUBT)))
    nearness = math.log(within_mm / max(expected_mm, 1e-6))
    return mode * _logistic(_TIPS[0] + _TIPS[1] * nearness)


def _logistic(x: float) -> float:
    """Return the logistic function."""
    return 1 / (1 + math.exp(-max(x, -700.0)))


_NEAR = np.deg2rad(60.0)  # rotation between modes that are covered by one covariance
_DISTAL_PX = 2.2  # distance of the contour at wrist and jaws, beyond which the standard deviations grow with it


def _occlusion_factor(quality: Quality, pixel_scale: float = 1.0) -> float:
    """Return the factor on a covariance for contour that is far off at wrist and jaws.

    A frame by itself takes its depth from what it shows of these, so that what a model is off by there counts in
    pixels; one that its session supports does not.
    """
    return max(1.0, quality.distal_px / (_DISTAL_PX * pixel_scale)) ** 2


def rough_covariance(covariance: Float64, noise: OutlineNoise, quality: Quality, pixel_scale: float) -> Float64:
    """Widen the covariance (6 + J, 6 + J) of a frame that was fitted with its session by what a rough contour adds.

    ``covariance`` is that of a Gauss-Newton fit, which holds for errors that are small and normal; ``pixel_scale`` is
    that of the camera.
    """
    return covariance * noise.inflation(pixel_scale) * _occlusion_factor(quality, pixel_scale)


def pose_covariance(modes: Sequence[Fit], quality: Quality) -> Float64:
    """Return the covariance (6 + J, 6 + J) of small changes of the first mode, whose ``quality`` is given.

    It includes the other modes within 60 degrees, each with its share of the probability. Modes farther away, such as
    the mirror twin, are not a small change of the pose; they are in the mode's probability.
    """
    best, weights = modes[0], mode_weights(modes)
    covariance = np.linalg.inv(best.information) * _occlusion_factor(quality)
    for mode, weight in zip(modes[1:], weights[1:], strict=True):
        if rotation_angle(best.at.pose, mode.at.pose) < _NEAR:
            apart = mode.at.minus(best.at)
            covariance += weight / (weight + weights[0]) * np.outer(apart, apart)
    return np.asarray(covariance, dtype=np.float64)


PARAMETERS: Final = ("focal_length", "aspect", "centre_right", "centre_down", "radial", "instrument_size")

_CAMERA_STEP: Final = 1e-5  # m and rad
_ALONG: Final = 5e-3  # m, between the points of the shaft
_MOST: Final = 40  # vertices of a link
_JOINT: Final = np.deg2rad(10.0)  # standard deviation of joints that readings hold, where points are good to a pixel
_CAMERA_NEAR: Final = 5e-3  # m, of points in front of the camera
_LONGEST: Final = 0.15  # m of shaft, more than is in view
_HELD: Final = 1e-3  # px^2 per m^2 or rad^2: keeps the equations solvable


def file_covariance(camera: Camera | None, config: CameraConfig) -> Float64:
    """Return the covariance (6, 6) of the parameters, of the camera's that which its file states if it does."""
    centre = config.principal_point_percent / 100
    std = [config.focal_length_percent / 100, config.aspect_percent / 100, centre, centre, config.radial]
    covariance = np.diag(np.square([*std, config.instrument_size_percent / 100]))
    if camera is not None and camera.covariance:
        covariance[:-1, :-1] = camera.covariance
    return covariance


def displacements(camera: Camera, pixels: Float64, tangent: Float64) -> Float64:
    """Return the moves (N, 2, 5), px, of pixels (N, 2) of points with x/z, y/z (N, 2) by the camera's parameters."""
    focal, off = np.array([camera.fx, camera.fy]), pixels - [camera.cx, camera.cy]
    radial = focal * camera.by_radial(tangent)
    right, down = np.array([[camera.fx, 0.0], [0.0, camera.fx]])
    columns = [off, off * [-0.5, 0.5], *(np.broadcast_to(each, off.shape) for each in (right, down)), radial]
    return np.stack(columns, axis=2)


def moves_by_camera(instrument: Instrument, camera: Camera, at: Posed) -> Float64:
    """Return the change (6 + J, 6) of a pose and its joints with each parameter by which it is read.

    It is that of least squares over points of the instrument in the image, of which those of the shaft count only where
    they are across it; zero where none is in view. A larger instrument is farther away in the same proportion.
    """
    count = 6 + len(at.joints)
    links, points = _points(instrument)
    changes = at.moved(_CAMERA_STEP * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)]))
    frames = (changes.pose[:, None] @ instrument.forward(changes.joints))[:, links]
    placed = (frames[..., :3, :3] @ points[..., None])[..., 0] + frames[..., :3, 3]
    seen = (placed[..., 2] > _CAMERA_NEAR).all(axis=0)
    placed, on_shaft = placed[:, seen], (links[seen] == 0) & (instrument.shaft is not None)
    pixels = camera.project(placed)
    inside = ((pixels[0] > -0.5) & (pixels[0] < [camera.width - 0.5, camera.height - 0.5])).all(axis=1)
    pixels, on_shaft = pixels[:, inside], on_shaft[inside]
    if not inside.any():
        return np.zeros((count, len(PARAMETERS)))
    by_pose = np.moveaxis(pixels[1 : count + 1] - pixels[count + 1 :], 0, 2) / (2 * _CAMERA_STEP)
    by_camera = displacements(camera, pixels[0], placed[0, inside, :2] / placed[0, inside, 2:])
    if on_shaft.any():
        along = np.linalg.svd(pixels[0, on_shaft] - pixels[0, on_shaft].mean(axis=0))[2][0]
        across = np.where(on_shaft[:, None, None], np.eye(2) - np.outer(along, along), np.eye(2))
        by_pose, by_camera = across @ by_pose, across @ by_camera
    by_pose, by_camera = by_pose.reshape(-1, count), by_camera.reshape(len(by_pose) * 2, -1)
    held = np.diag([_HELD] * 6 + [1 / _JOINT**2] * (count - 6))
    by_size = np.zeros((count, 1))
    by_size[:3, 0] = at.pose[:3, :3].T @ apply(at.pose, instrument.ends(at.joints)).mean(axis=0)
    return np.hstack([-np.linalg.solve(by_pose.T @ by_pose + held, by_pose.T @ by_camera), by_size])


def covariance_by_camera(instrument: Instrument, camera: Camera, at: Posed, errors: Float64) -> Float64:
    """Return the covariance (6 + J, 6 + J) of a pose by errors of the parameters, whose covariance is (6, 6)."""
    moves = moves_by_camera(instrument, camera, at)
    return np.asarray(moves @ errors @ moves.T)


@lru_cache(maxsize=8)
def _points(instrument: Instrument) -> tuple[Indices, Float64]:
    """Return points of the instrument: the links (N,) that have them, and their places (N, 3) there, m."""
    found, shaft = [], instrument.shaft
    for number, link in enumerate(instrument.links):
        points = link.vertices[:: max(len(link.vertices) // _MOST, 1)]
        if number == 0 and shaft is not None:
            along = np.arange(shaft.distal_end, max(shaft.proximal_end, shaft.distal_end - _LONGEST), -_ALONG)
            sides = shaft.radius * plane_basis(shaft.direction)
            axis = shaft.point + along[:, None] * shaft.direction
            points = np.concatenate([axis + side for side in (*sides, *-sides)])
        found.append((np.full(len(points), number), points))
    links, points = zip(*found, strict=True)
    return np.concatenate(links), np.concatenate(points)
