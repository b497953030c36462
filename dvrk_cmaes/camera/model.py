"""Camera model: projection of points in the camera's frame to pixels, and directions of pixels.

OpenCV's camera frame: x right, y down, z forward, metres. Pixel (u, v) has its centre at integer coordinates, so the
image covers [-0.5, width - 0.5] x [-0.5, height - 0.5]. The ray of a pixel is ``[normalise(pixel), 1]``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.camera.lens import COEFFICIENT_COUNTS, Lens
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.arguments import checked_array, checked_number

_WIDTH_OF_LIMITS = 640  # px, of the images on which limits in pixels were set


@lru_cache(maxsize=64)
def _lens_of(model: str, coefficients: tuple[float, ...], border: bytes) -> Lens:
    """Return a lens, whose radius takes longer to find than a pose to draw; the last ones are kept for equal cameras.

    ``border`` are the bytes of that of `Lens`, (N, 2) float64.
    """
    return Lens(model, coefficients, np.frombuffer(border).reshape(-1, 2))


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a camera and the distortion of its lens.

    Parameters
    ----------
    width, height
        Size of the image in pixels.
    fx, fy, cx, cy
        Focal lengths and principal point in pixels.
    distortion
        Coefficients in OpenCV's order; with none, or only zeros, the camera is a pinhole. This does not hold for
        ``equidistant``, where zeros mean that the distorted radius equals the angle to the optical axis.
    model
        ``plumb_bob`` (0, 4 or 5 coefficients), ``rational_polynomial`` (0 or 8) or ``equidistant`` (4).
    covariance
        Covariance (5, 5) of the calibration's errors, where it is known: of log f, log (fy / fx), the principal point
        right and down over f, and the first radial coefficient; empty where it is not.
    remarks
        What is unusual about the camera's file; every result that uses the camera repeats it.

    Raises
    ------
    InputError
        A size or focal length that is not positive, a number that is not finite, an unknown model, a wrong number
        of coefficients, or a distortion that is not one-to-one over the image.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    model: str = "plumb_bob"
    covariance: tuple[tuple[float, ...], ...] = field(default=(), repr=False)
    remarks: tuple[str, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = checked_number(name, getattr(self, name), "a positive whole number of pixels")
            if not (math.isfinite(size) and size == int(size) and size > 0):
                raise InputError(f"{name}: expected a positive whole number of pixels, got {size:g}")
            object.__setattr__(self, name, int(size))
        for name in ("fx", "fy", "cx", "cy"):
            value = checked_number(name, getattr(self, name), "a finite number of pixels")
            if not math.isfinite(value):
                raise InputError(f"{name}: expected a finite number of pixels, got {value}")
            if name.startswith("f") and value <= 0:
                raise InputError(f"{name}: expected a positive focal length in pixels, got {value:g}")
            object.__setattr__(self, name, value)
        expected = "coefficients, e.g. (k1, k2, p1, p2, k3)"
        given = list(self.distortion) if isinstance(self.distortion, tuple) else self.distortion
        coefficients = tuple(checked_array("distortion", given, float, expected, dimensions=1).tolist())
        object.__setattr__(self, "distortion", coefficients)
        if self.model not in COEFFICIENT_COUNTS:
            names = ", ".join(nearest_first(self.model, COEFFICIENT_COUNTS))
            raise InputError(f"distortion model: expected one of {names}, got {self.model!r}")
        counts = COEFFICIENT_COUNTS[self.model]
        if len(coefficients) not in counts:
            expected = " or ".join(str(n) for n in counts)
            raise InputError(f"distortion: expected {expected} coefficients for {self.model}, got {len(coefficients)}")
        if not all(math.isfinite(c) for c in coefficients):
            raise InputError(f"distortion: expected finite coefficients, got {list(coefficients)}")
        _ = self._lens  # raises an InputError for a distortion that is not one-to-one

    @cached_property
    def _lens(self) -> Lens | None:
        return None if self.is_pinhole else _lens_of(self.model, self.distortion, self._border().tobytes())

    @property
    def matrix(self) -> Float64:
        """The intrinsic matrix K, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def pixel_scale(self) -> float:
        """Factor on limits in pixels, which are those of images 640 px wide: they grow with wider images.

        What an instrument that differs from its model, or a segmenter, is off by in an image grows with its width.
        """
        return max(1.0, self.width / _WIDTH_OF_LIMITS)

    @property
    def is_pinhole(self) -> bool:
        """Whether the camera has no distortion, so that the images of straight lines are straight."""
        return self.model != "equidistant" and not any(self.distortion)

    @property
    def lens_radius(self) -> float:
        """Undistorted radius |x/z, y/z| up to which the distortion model is used unchanged; infinite for a pinhole."""
        return float("inf") if self._lens is None else self._lens.radius

    def scaled(self, width: int, height: int) -> Camera:
        """Return the camera of the image resized to another size, in pixels.

        Pixels are areas, and corners of the image are mapped to corners: cx' + 0.5 = (cx + 0.5) s. The scales s of
        width and height may differ, as they do where a size is rounded to whole pixels.

        Parameters
        ----------
        width
            The other width, px.
        height
            The other height, px.
        """
        if width <= 0 or height <= 0:
            raise InputError(f"image size: expected positive sizes in pixels, got {width} x {height}")
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )

    def changed(self, focal_scale: float, shift: tuple[float, float]) -> Camera:
        """Return the camera with focal lengths times ``focal_scale`` and a principal point moved by ``shift``, px.

        Parameters
        ----------
        focal_scale
            Factor of both focal lengths.
        shift
            Move of the principal point to the right and down, px.

        Raises
        ------
        InputError
            With the changed focal length, the distortion is not one-to-one over the image.
        """
        fx, fy = self.fx * focal_scale, self.fy * focal_scale
        return replace(self, fx=fx, fy=fy, cx=self.cx + shift[0], cy=self.cy + shift[1])

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera of a window of the image whose first pixel is (left, top), sizes in pixels.

        Parameters
        ----------
        left
            First column of the window.
        top
            First row of the window.
        width
            Width of the window, px.
        height
            Height of the window, px.
        """
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def distort(self, xy: ArrayLike) -> NDArray[Any]:
        """Map undistorted to distorted normalised coordinates, (..., 2) to (..., 2); float32 stays float32.

        The map is the model's inside the image and slightly beyond; outside it is continued so that it is continuous
        and one-to-one (see ``lens``). A pinhole returns the array itself if it is of a floating-point type.

        Parameters
        ----------
        xy
            Undistorted coordinates x/z, y/z, (..., 2).
        """
        points = _floats(xy)
        return points if self._lens is None else self._lens.distort(points)

    def by_radial(self, xy: Float64) -> Float64:
        """Differentiate `distort` by the first radial coefficient at undistorted points (..., 2) in the image.

        Parameters
        ----------
        xy
            Undistorted coordinates x/z, y/z, (..., 2).
        """
        return xy * (xy * xy).sum(axis=-1, keepdims=True) if self._lens is None else self._lens.by_radial(xy)

    def project(self, points: ArrayLike) -> NDArray[Any]:
        """Project points (..., 3) in the camera's frame, m, to pixels (..., 2); float32 stays float32.

        Parameters
        ----------
        points
            Points (..., 3) in the camera's frame, m.

        Raises
        ------
        ValueError
            A point does not lie in front of the camera (z is not positive).
        """
        xyz = _floats(points)
        depth = xyz[..., 2:]
        if np.any(depth <= 0):
            raise ValueError("only points before the camera can be projected: z must be positive")
        pixels = self.distort(xyz[..., :2] / depth)  # a new array, so it may be overwritten
        pixels *= self._focal(pixels.dtype)
        pixels += self._principal(pixels.dtype)
        return pixels

    def project_along(self, points: Float64, directions: Float64) -> tuple[Float64, Float64]:
        """Project points (N, 3) in front of the camera, m, to pixels (N, 2), and compute how these move with them.

        That is the gradient (N, 3), px/m, of a pixel's coordinate along a direction (N, 2), times its length.

        Parameters
        ----------
        points
            Points (N, 3) in the camera's frame, m.
        directions
            Directions (N, 2) in the image, a vector for each point.
        """
        depth = points[:, 2:]
        xy = points[:, :2] / depth
        focal = self._focal(xy.dtype)
        pixels, along = xy, directions * focal
        if self._lens is not None:
            pixels, along = self._lens.distort_along(xy, along)
        gradient = np.column_stack([along, -(along * xy).sum(axis=1)]) / depth
        return pixels * focal + self._principal(xy.dtype), gradient

    def normalise(self, pixels: ArrayLike) -> NDArray[Any]:
        """Map pixels (..., 2) to undistorted x/z, y/z, the inverse of ``project``; float32 stays float32.

        Parameters
        ----------
        pixels
            Pixels (..., 2).
        """
        given = _floats(pixels)
        if self._lens is None:
            return self._without_matrix(given)
        distorted = self._without_matrix(given.astype(np.float64))
        return self._lens.undistort(distorted).astype(given.dtype, copy=False)

    def _without_matrix(self, pixels: NDArray[Any]) -> NDArray[Any]:
        """Map pixels to distorted normalised coordinates."""
        out: NDArray[Any] = pixels - self._principal(pixels.dtype)
        out /= self._focal(pixels.dtype)
        return out

    def _focal(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        return np.array([self.fx, self.fy], dtype=dtype)

    def _principal(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        return np.array([self.cx, self.cy], dtype=dtype)

    def _border(self, samples: int = 128) -> Float64:
        """Return distorted normalised points (4 * samples, 2) along the border of the image, including the corners."""
        u = np.linspace(-0.5, self.width - 0.5, samples)
        v = np.linspace(-0.5, self.height - 0.5, samples)
        left, right = np.full(samples, u[0]), np.full(samples, u[-1])
        top, bottom = np.full(samples, v[0]), np.full(samples, v[-1])
        pixels = np.stack([np.concatenate([u, u, left, right]), np.concatenate([top, bottom, v, v])], axis=-1)
        return self._without_matrix(pixels)


def _floats(values: ArrayLike) -> NDArray[Any]:
    """Convert to an array of float64, unless the values are an array of float32."""
    array = np.asarray(values)
    return array if array.dtype in (np.float32, np.float64) else array.astype(np.float64)
