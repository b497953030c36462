"""Lens distortion as an invertible map of normalised image coordinates (x/z, y/z).

The models and the order of their coefficients are OpenCV's, as ROS camera files name them: ``plumb_bob``
(Brown 1966: k1 k2 p1 p2 [k3]), ``rational_polynomial`` (k1 k2 p1 p2 k3 k4 k5 k6) and ``equidistant`` (Kannala and
Brandt 2006, the fisheye: k1 k2 k3 k4). They are fitted inside the image and are not one-to-one far outside of it, where
vertices of a candidate pose may be projected. Beyond a circle of radius R, which encloses the image, the map is
therefore continued linearly along each ray, distort(R x/|x|) |x|/R. The continued map equals the model inside the image
and is continuous and one-to-one everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.geometry import Float64

COEFFICIENT_COUNTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 8), "equidistant": (4,)}
"""Numbers of distortion coefficients that each model may have."""

_FOLDS = "distortion: expected the {} map to be one-to-one over the image, got one that folds back on itself{}"
_MARGINS = (1.02, 1.005, 1.0005)  # R / the image's largest undistorted radius; the first that is one-to-one is used
_LAST_STEP = 1e-7  # last step of Newton's method; its convergence is quadratic, so the error is far below 1e-9
_BLOCK = 16384  # points that are undistorted at a time, so that they fit in the processor's cache
_LARGEST_RADIUS = 64.0  # tan of 89 degrees; (x/z, y/z) does not exist at 90 degrees


class Lens:
    """The distortion of one camera's lens and its inverse.

    Parameters
    ----------
    model
        ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
    coefficients
        In OpenCV's order, as many as ``COEFFICIENT_COUNTS`` allows; at least one.
    border
        (N, 2) distorted points (x/z, y/z) along the border of the image, inside which the model is used unchanged.

    Raises
    ------
    InputError
        The map is not one-to-one over the image.
    """

    def __init__(self, model: str, coefficients: tuple[float, ...], border: Float64) -> None:
        self.model = model
        if model == "equidistant":
            self._k = coefficients
            self._p = (0.0, 0.0)
        else:
            k1, k2, p1, p2, k3, *denominator = (*coefficients, 0.0) if len(coefficients) == 4 else coefficients
            self._k = (k1, k2, k3, *(denominator or (0.0, 0.0, 0.0)))
            self._p = (p1, p2)
        self.radius = float("inf")  # R; no continuation while the image's radius is computed
        with np.errstate(all="ignore"):
            self.radius = self._find_radius(border)
        self._table_r = np.linspace(0.0, self.radius, 1024)
        self._table_distorted = self._table_r * self._factor(self._table_r**2)

    def distort(self, xy: NDArray[Any]) -> NDArray[Any]:
        """Distort points (..., 2) of x/z, y/z; float32 or float64 is kept."""
        if not xy.size:
            return xy
        x, y = xy[..., 0], xy[..., 1]
        squared = x * x + y * y
        far = squared.max() > self.radius**2
        if far:
            scale = np.maximum(np.sqrt(squared) / self.radius, 1.0)
            x, y = x / scale, y / scale
            squared = x * x + y * y
        out = np.empty_like(xy)
        out[..., 0], out[..., 1] = self._raw(x, y, squared)
        if far:
            out *= scale[..., None]
        return out

    def distort_along(self, xy: Float64, directions: Float64) -> tuple[Float64, Float64]:
        """Distort points (N, 2) of x/z, y/z, and differentiate their coordinates along directions.

        Returns the distorted points (N, 2), and the gradients (N, 2) by x/z, y/z of the products of each with its
        vector of ``directions`` (N, 2).
        """
        value, (x_by_x, x_by_y, y_by_x, y_by_y) = self._value_and_jacobian(xy[:, 0], xy[:, 1])
        a, b = directions[:, 0], directions[:, 1]
        return np.stack(value, axis=-1), np.stack([a * x_by_x + b * y_by_x, a * x_by_y + b * y_by_y], axis=-1)

    def by_radial(self, xy: Float64) -> Float64:
        """Differentiate ``distort`` by the first radial coefficient, k1, at points (..., 2) in the image."""
        s = (xy * xy).sum(axis=-1, keepdims=True)
        if self.model == "equidistant":
            r = np.sqrt(s)
            return np.asarray(xy * np.divide(np.arctan(r) ** 3, r, out=np.zeros_like(r), where=r > 0))
        k4, k5, k6 = self._k[3:]
        return np.asarray(xy * s / (1 + s * (k4 + s * (k5 + s * k6))))

    def undistort(self, distorted: Float64) -> Float64:
        """Invert ``distort`` on float64 points (..., 2), by Newton's method, to 1e-9 or better."""
        points = distorted.reshape(-1, 2)
        out = np.empty_like(points)
        for i in range(0, len(points), _BLOCK):
            out[i : i + _BLOCK] = self._undistort_block(points[i : i + _BLOCK])
        return out.reshape(distorted.shape)

    def _undistort_block(self, distorted: Float64) -> Float64:
        """Undistort (N, 2) points, starting from the inverse of the radial distortion."""
        radius = np.hypot(distorted[:, 0], distorted[:, 1])
        end = self._table_distorted[-1]
        start = np.interp(radius, self._table_distorted, self._table_r) * np.maximum(radius / end, 1.0)
        ratio = np.divide(start, radius, out=np.ones_like(radius), where=radius > 0)
        solution, step = self._newton(distorted, distorted * ratio[:, None])
        if step > _LAST_STEP:
            raise DvrkCmaesError(f"undistorting did not converge (last step {step:.1e})")
        return solution

    def _factor(self, squared: NDArray[Any]) -> NDArray[Any]:
        """Compute distorted / undistorted radius from the squared undistorted radius, without tangential distortion."""
        factor: NDArray[Any]
        if self.model == "equidistant":
            r = np.sqrt(squared)
            k1, k2, k3, k4 = self._k
            angle = np.arctan(r)
            t = angle * angle
            angle *= 1 + t * (k1 + t * (k2 + t * (k3 + t * k4)))
            factor = np.divide(angle, r, out=np.ones_like(r), where=r > 0)
            return factor
        k1, k2, k3, k4, k5, k6 = self._k
        factor = 1 + squared * (k1 + squared * (k2 + squared * k3))
        if k4 or k5 or k6:
            factor /= 1 + squared * (k4 + squared * (k5 + squared * k6))
        return factor

    def _factor_slope(self, squared: Float64, factor: Float64) -> Float64:
        """Differentiate ``_factor`` by its argument."""
        s = squared
        if self.model == "equidistant":
            k1, k2, k3, k4 = self._k
            t = np.arctan(np.sqrt(s)) ** 2
            radial = (1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * 9 * k4)))) / (1 + s)
            return np.divide(radial - factor, 2 * s, out=np.full_like(s, k1 - 1 / 3), where=s > 0)
        k1, k2, k3, k4, k5, k6 = self._k
        slope = k1 + s * (2 * k2 + s * 3 * k3)
        if k4 or k5 or k6:
            slope = (slope - factor * (k4 + s * (2 * k5 + s * 3 * k6))) / (1 + s * (k4 + s * (k5 + s * k6)))
        return slope

    def _raw(self, x: NDArray[Any], y: NDArray[Any], squared: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Apply the distortion model without the continuation."""
        factor = self._factor(squared)
        p1, p2 = self._p
        if not (p1 or p2):
            return x * factor, y * factor
        factor += 2 * p2 * x + 2 * p1 * y  # x (2 p2 x + 2 p1 y) + p2 r^2: the tangential terms, factored
        return x * factor + p2 * squared, y * factor + p1 * squared

    def _raw_jacobian(self, x: Float64, y: Float64, squared: Float64) -> tuple[Float64, Float64, Float64]:
        """Compute the entries xx, xy, yy of the model's Jacobian, which is symmetric; each of the shape of x and y."""
        factor = self._factor(squared)
        slope = 2 * self._factor_slope(squared, factor)
        p1, p2 = self._p
        return (
            factor + x * x * slope + 2 * p1 * y + 6 * p2 * x,
            x * y * slope + 2 * p1 * x + 2 * p2 * y,
            factor + y * y * slope + 6 * p1 * y + 2 * p2 * x,
        )

    def _value_and_jacobian(self, x: Float64, y: Float64) -> tuple[tuple[Float64, ...], tuple[Float64, ...]]:
        """Compute value (x, y) and Jacobian (xx, xy, yx, yy) of the continued map, each of the shape of x and y."""
        squared = x * x + y * y
        scale = np.maximum(np.sqrt(squared) / self.radius, 1.0)
        beyond = scale > 1
        any_beyond = bool(beyond.any())
        if any_beyond:
            x, y = x / scale, y / scale
            squared = x * x + y * y
        value = self._raw(x, y, squared)
        xx, xy, yy = self._raw_jacobian(x, y, squared)
        if not any_beyond:
            return value, (xx, xy, xy, yy)
        # f(x) = |x|/R g(u) with u = R x/|x|, so f' = g' + (g - g' u) u'/R^2
        ux, uy = x * beyond / self.radius**2, y * beyond / self.radius**2
        gx, gy = value[0] - xx * x - xy * y, value[1] - xy * x - yy * y
        return (value[0] * scale, value[1] * scale), (xx + gx * ux, xy + gx * uy, xy + gy * ux, yy + gy * uy)

    def _newton(self, target: Float64, start: Float64) -> tuple[Float64, float]:
        """Solve distort(x) = target, both (N, 2), from a start; return x and the last step relative to 1 + |x|."""
        x, y = start[:, 0], start[:, 1]
        largest = np.inf
        for _ in range(30):
            (fx, fy), (xx, xy, yx, yy) = self._value_and_jacobian(x, y)
            ex, ey = target[:, 0] - fx, target[:, 1] - fy
            determinant = xx * yy - xy * yx
            dx, dy = (yy * ex - xy * ey) / determinant, (xx * ey - yx * ex) / determinant
            x, y = x + dx, y + dy
            relative = np.maximum(np.abs(dx), np.abs(dy)) / (1 + np.abs(x) + np.abs(y))
            largest = float(np.fmax.reduce(relative))
            if largest < _LAST_STEP:
                break
        return np.stack([x, y], axis=-1), largest

    def _find_radius(self, border: Float64) -> float:
        """Compute the radius R within which the model is used; InputError if the model is not one-to-one there."""
        folds = InputError(_FOLDS.format(self.model, " or reaches 90 deg" if self.model == "equidistant" else ""))
        wanted = float(np.hypot(border[:, 0], border[:, 1]).max())
        r, distorted = self._rising_part(wanted)
        start = np.interp(np.hypot(border[:, 0], border[:, 1]), distorted, r)
        direction = border / np.maximum(np.hypot(border[:, 0], border[:, 1]), 1e-300)[:, None]
        undistorted, step = self._newton(border, direction * start[:, None])
        if not step < _LAST_STEP:
            raise folds
        largest = float(np.hypot(undistorted[:, 0], undistorted[:, 1]).max())
        for margin in _MARGINS:
            if self._one_to_one(largest * margin):
                return largest * margin
        raise folds

    def _rising_part(self, wanted: float) -> tuple[Float64, Float64]:
        """Tabulate the radial map from 0 to where it reaches the wanted distorted radius or stops increasing."""
        end = 2 * wanted
        while True:
            r = np.linspace(0.0, end, 2048)
            distorted = r * self._factor(r * r)
            rising = np.diff(distorted) > 0
            if not rising.all():
                count = max(int(np.argmin(rising)), 1) + 1
                return r[:count], distorted[:count]
            if distorted[-1] > wanted or end > _LARGEST_RADIUS:
                return r, distorted
            end *= 2

    def _one_to_one(self, radius: float) -> bool:
        """Whether the model is one-to-one on the disc of a radius, and its continuation outside.

        A map whose Jacobian determinant is positive on a disc is one-to-one there if it is one-to-one on the bounding
        circle. If the polar angle of the circle's image increases along the circle, the map on the circle and the
        continuation are one-to-one.
        """
        angle = np.linspace(0.0, 2 * np.pi, 180, endpoint=False)
        rings = np.linspace(0.0, radius, 257)[:, None]
        x, y = rings * np.cos(angle), rings * np.sin(angle)
        xx, xy, yy = self._raw_jacobian(x, y, x * x + y * y)
        x, y = x[-1], y[-1]
        seen_x, seen_y = self._raw(x, y, x * x + y * y)
        turning = seen_x * (yy[-1] * x - xy[-1] * y) - seen_y * (xy[-1] * x - xx[-1] * y)
        sound = (xx * yy - xy * xy > 0).all() and (xx + yy > 0).all() and (turning > 0).all()
        return bool(sound and radius < _LARGEST_RADIUS)
