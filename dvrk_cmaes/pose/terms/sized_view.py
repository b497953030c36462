"""A view of a frame at one image size: the mask as it is compared with silhouettes, and how these are drawn.

The interface of terms of the outline: what is drawn at a pose serves its value and its derivatives.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Generic, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.gather import shrunk, window_around
from dvrk_cmaes.evidence.outline_noise import distances_to, less_margin
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.shared_errors import image_axis, sides_of_shaft
from dvrk_cmaes.pose.terms.term import Approximation
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.silhouette import OutlinePoints, Renderer
from dvrk_cmaes.silhouette.moving_points import moving_points

Float64 = NDArray[np.float64]

REACH = 4
"""Distance, px, from the outline up to which differences are sampled."""

REMEMBERED = 64  # drawings that a view keeps
_FARTHEST = 4.0  # standard deviations of the blur to which its filter reaches
_AROUND_MARGIN = 3  # px beside a margin, on which what is left of a mask does not depend
_BLURRED_IN = 2.0  # standard deviations of the blur, over which the mask's value at ignored pixels reaches others


class SizedView:
    """A view at 1 / ``shrink`` of its size, in a window around the mask.

    mask : (H, W) bool, of the window. target : the blurred mask. weight : (H, W), 0 for ignored pixels and
    beside them, 1 for others. length : px of contour at this size. view, shrink : as given. Poses are in the reference
    camera. ``blur``, px, is the standard deviation of that of coverage and mask; ``renderer`` draws
    another body than that of the view, if given, and ``differences`` is that of which the outlines are drawn for
    differences. ``margin``, px of the whole size, is taken off the mask all round.

    The last drawings are kept: a refinement often begins where another one has drawn already.
    """

    def __init__(
        self,
        view: FrameView,
        *,
        blur: float,
        shrink: int = 1,
        renderer: Renderer | None = None,
        margin: float = 0.0,
    ) -> None:
        evidence, camera = view.evidence, view.evidence.camera
        size = (camera.width, camera.height)
        around, first, above = 48 // shrink + 8, 0, 0
        if shrink > 1:
            size = max(camera.width // shrink, 8), max(camera.height // shrink, 8)
            mask = shrunk(less_margin(evidence.mask, margin) if margin else evidence.share, *size)
        else:
            reach = around + int(abs(margin)) + _AROUND_MARGIN
            first, above, width, height = window_around(evidence.mask, reach)
            inside = np.s_[above : above + height, first : first + width]
            part = evidence.mask[inside]
            mask = less_margin(part, margin) if margin else part.astype(np.float32)
        left, top, width, height = window_around(mask > 0, around)
        mask = np.ascontiguousarray(mask[top : top + height, left : left + width])
        left, top = first + left, above + top
        self.view, self._size, self._window = view, size, (left, top, width, height)
        used = view.renderer if renderer is None else renderer
        self.camera = self._in_window(camera)
        self.renderer = Renderer(used.body, self.camera, threads=used.threads)
        self.weight = np.ones((height, width), dtype=np.float32)
        if evidence.ignores:
            weight = evidence.weight if shrink == 1 else evidence.weight_at(*size)
            beside = int(np.ceil(_BLURRED_IN * blur))
            above, before = min(top, beside), min(left, beside)
            weight = weight[top - above : top + height + beside, left - before : left + width + beside]
            weight = np.asarray(cv2.erode(weight, np.ones((2 * beside + 1, 2 * beside + 1))), dtype=np.float32)
            self.weight = np.ascontiguousarray(weight[above : above + height, before : before + width])
        self.mask = mask > 0.5
        self.target = _kernel.Target(mask, self.weight, blur_filter(blur), REACH)
        self.shrink = shrink
        self.length = max(len(evidence.contour.pixels) / shrink, 20.0)
        self._remembered: dict[tuple[object, ...], _kernel.Comparison] = {}

    def placed(self, view_from_camera: Float64) -> SizedView:
        """Return the same view at another place of the rig."""
        other = copy(self)
        other.view = replace(self.view, view_from_camera=view_from_camera)
        return other

    def _in_window(self, camera: Camera) -> Camera:
        """Return the camera of the window at this size."""
        resized = camera if self._size == (camera.width, camera.height) else camera.scaled(*self._size)
        return resized.cropped(*self._window)

    def draw(
        self, at: Posed, lines_per_pixel: int, cauchy: Sequence[float], derivatives: str | None
    ) -> list[_kernel.Comparison]:
        """Draw C poses and compare them with the mask, by losses of some widths; outlines are with ``derivatives``."""
        seen = at.seen_from(self.view.view_from_camera)
        keys = [(seen.pose[k].tobytes(), seen.joints[k].tobytes(), lines_per_pixel, *cauchy) for k in range(len(seen))]
        kept = ((key, self._remembered.get(key)) for key in keys)
        differences = derivatives == "differences"
        known = {
            key: one
            for key, one in kept
            if one is not None and (derivatives is None or (one.outlined and one.differenced == differences))
        }
        missing = [k for k, key in enumerate(keys) if key not in known]
        if missing:
            outlined = derivatives is not None
            drawn = self.renderer.compare(
                seen[missing], self.target, cauchy, lines_per_pixel=lines_per_pixel, outlines=outlined
            )
            if differences:
                self.renderer.difference(drawn, seen[missing], lines_per_pixel=lines_per_pixel)
            known |= zip([keys[k] for k in missing], drawn, strict=True)
            self._remembered = dict(list((self._remembered | known).items())[-REMEMBERED:])
        return [known[key] for key in keys]

    def silhouette(self, drawn: _kernel.Comparison) -> NDArray[np.bool_]:
        """Return the silhouette of a drawing in the whole image; nothing is outside the window."""
        left, top, width, height = self._window
        whole = np.zeros(self._size[::-1], dtype=np.bool_)
        whole[top : top + height, left : left + width] = drawn.coverage(width) > 0.5
        return whole

    def outlines(self, at: Posed) -> list[OutlinePoints]:
        """Find the outline of each of C poses."""
        seen = at.seen_from(self.view.view_from_camera)
        return self.renderer.outlines(seen.pose, seen.joints)

    def contours(self, at: Posed, errors: _kernel.ContourErrors) -> tuple[Float64, Float64, Float64]:
        """Compare the outlines of C poses with the mask's contour, as `Renderer.contours`."""
        return self.renderer.contours(at.seen_from(self.view.view_from_camera), self.mask, self.weight, errors)

    def jacobians(self, outlines: Sequence[OutlinePoints], at: Posed) -> list[Float64]:
        """Return the Jacobian (N, 6 + J) of the points of the outlines of C poses, as in `MovingPoints`."""
        seen = at.seen_from(self.view.view_from_camera)
        of_poses = moving_points(self.renderer.body.instrument, self.camera, outlines, seen)
        return [moving.jacobian for moving in of_poses]

    def offsets(self, outline: OutlinePoints) -> Float64:
        """Return by how much the mask lies outwards of an outline at its N points, px."""
        return -distances_to(self.mask, outline.pixels)

    def sides_of_shaft(self, outline: OutlinePoints, at: Posed) -> NDArray[np.bool_]:
        """Return which points (N, 2) of the outline of one pose are on each side of the shaft."""
        seen = at.seen_from(self.view.view_from_camera)
        return sides_of_shaft(outline, self.renderer.body.instrument, self.camera, seen)

    def axis(self, at: Posed) -> Float64:
        """Return the direction (2,) in the image along which the shaft of one pose points."""
        return image_axis(self.renderer.body.instrument, self.camera, at.seen_from(self.view.view_from_camera))


def blur_filter(blur: float) -> list[float]:
    """Return the taps of a normal distribution with a standard deviation, px, from its middle outwards."""
    reach = round(_FARTHEST * blur)
    return [float(tap) for tap in cv2.getGaussianKernel(2 * reach + 1, blur)[reach:, 0]]


D = TypeVar("D")
Derivatives = Literal["closed-form", "differences"]
"""How an outline's derivatives are found: from the motion of its points on the surface, or by central differences."""


class OutlineTerm(ABC, Generic[D]):
    """A sum of squares that compares outlines with masks, in a unit of its own; its weight is apart from it.

    Drawing is what costs time, so value and approximation are computed from what was drawn, of the type D.
    """

    views: tuple[SizedView, ...]

    @abstractmethod
    def draw(self, at: Posed, *, derivatives: Derivatives | None = "closed-form") -> list[D]:
        """Draw C poses; the approximation needs what is drawn with ``derivatives``."""

    @abstractmethod
    def cost_of(self, drawn: D) -> float:
        """Return the sum of squares of what was drawn."""

    @abstractmethod
    def near(self, drawn: Sequence[D], at: Posed) -> Approximation:
        """Return the approximation of half the sum of squares near C poses that were drawn."""

    def weight_of(self, drawn: D) -> float:
        """Return the factor from the sum of squares of what was drawn to one in standard deviations."""
        return 1.0

    def score_of(self, drawn: D, *, final: bool = False) -> float:
        """Return the negative log-likelihood of the masks up to a constant.

        ``final`` asks for that by which fits are compared with each other, if it is not that which is made small.
        """
        return 0.5 * self.weight_of(drawn) * self.cost_of(drawn)

    @property
    def silhouettes(self) -> int:
        """Number of silhouettes drawn so far."""
        return sum(view.renderer.poses for view in self.views)
