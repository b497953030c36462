"""The loss of the coverage as a function of small changes of a pose, from profiles of the residual along the outline.

The residual image, blurred coverage less blurred mask, is sampled along the normal of each outline point. If the point
moves outwards by e px, the blurred coverage s px outside its present place becomes larger by e times the density of the
normal distribution at s whose standard deviation is that of the blur. The sum of the robust loss over all samples is
therefore a function of the change of the pose that needs no further silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.pose.terms.term import Approximation
from dvrk_cmaes.silhouette import OutlinePoints

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_REACH = 4  # px from the outline to which the residual is sampled
_LARGEST_SHIFT = 3.0  # px; beyond it an outline has left the profile that was sampled


@dataclass(frozen=True, eq=False)
class Profiles(Approximation):
    """Samples of residuals along the normals of C outlines, padded to N points each, K samples per point.

    residual : (C, N, K) blurred coverage less blurred mask. weight : (C, N, K) px of outline that the sample stands
    for, 0 at ignored pixels and for padding. jacobian : (C, N, D) of the displacement of the points along their unit
    normals, px. offsets : (K,) px along the normals, positive outside. blur : px, that of coverage and mask. cauchy :
    width of the robust loss.
    """

    residual: Float32
    weight: Float32
    jacobian: Float32
    offsets: Float32
    blur: float
    cauchy: float

    @classmethod
    def sampled(
        cls,
        residuals: Sequence[Float32],
        weight: Float32,
        outlines: Sequence[OutlinePoints],
        jacobians: Sequence[Float64],
        blur: float,
        cauchy: float,
    ) -> Profiles:
        """Sample C residual images (H, W) at the points of C outlines.

        ``jacobians`` (N, D) are of the displacements times the lengths of outline that the points represent;
        ``weight`` (H, W) is that of the pixels.
        """
        count = max(max(len(outline.pixels) for outline in outlines), 1)
        offsets = np.arange(-_REACH, _REACH + 1, dtype=np.float32)
        shape = len(outlines), count, len(offsets)
        profiles = cls(
            np.zeros(shape, np.float32),
            np.zeros(shape, np.float32),
            np.zeros((*shape[:2], jacobians[0].shape[1]), np.float32),
            offsets,
            blur,
            cauchy,
        )
        all_count = bool(weight.all())
        for i, (image, outline, jacobian) in enumerate(zip(residuals, outlines, jacobians, strict=True)):
            points = len(outline.pixels)
            if not points:
                continue
            length = np.linalg.norm(outline.normals, axis=1)
            unit = (outline.normals / length[:, None]).astype(np.float32)
            at = outline.pixels.astype(np.float32)
            u, v = (at[:, k : k + 1] + unit[:, k : k + 1] * offsets for k in (0, 1))
            profiles.residual[i, :points] = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            profiles.weight[i, :points] = length[:, None]
            if not all_count:
                shares = cv2.remap(weight, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                profiles.weight[i, :points] *= shares
            profiles.jacobian[i, :points] = jacobian / length[:, None]
        return profiles

    @property
    def count(self) -> int:
        """Number C of poses."""
        return len(self.residual)

    @property
    def dimension(self) -> int:
        """Number D of small changes."""
        return int(self.jacobian.shape[2])

    def select(self, index: Sequence[int]) -> Self:
        """Return the profiles of some of the outlines."""
        chosen = list(index)
        return replace(self, residual=self.residual[chosen], weight=self.weight[chosen], jacobian=self.jacobian[chosen])

    @classmethod
    def joined(cls, groups: Sequence[Self]) -> Self:
        """Return the profiles of several groups of outlines together."""
        if len(groups) == 1:
            return groups[0]
        count = max(group.residual.shape[1] for group in groups)

        def padded(values: Float32) -> Float32:
            more = count - values.shape[1]
            return np.pad(values, ((0, 0), (0, more), (0, 0))) if more else values

        return replace(
            groups[0],
            residual=np.concatenate([padded(group.residual) for group in groups]),
            weight=np.concatenate([padded(group.weight) for group in groups]),
            jacobian=np.concatenate([padded(group.jacobian) for group in groups]),
        )

    @staticmethod
    def of_views(views: Sequence[Profiles], factors: Sequence[float]) -> Profiles:
        """Return the profiles of the same poses in several views as one, with the loss of each times its factor.

        The changes of the poses have the same axes in every view, and the views the same blur.
        """
        if len(views) == 1:
            return views[0]
        weights = [view.weight * np.float32(factor) for view, factor in zip(views, factors, strict=True)]
        return replace(
            views[0],
            residual=np.concatenate([view.residual for view in views], axis=1),
            weight=np.concatenate(weights, axis=1),
            jacobian=np.concatenate([view.jacobian for view in views], axis=1),
        )

    def normal_equations(self, change: Float64) -> tuple[Float64, Float64]:
        """Compute information (C, D, D) and slope (C, D) of the robust loss at changes (C, D) of the poses.

        They are in sums of squares of coverage, with the weights of the Cauchy loss at the changed poses.
        """
        away = self.offsets * np.float32(1 / (np.sqrt(2) * self.blur))
        gradient = np.exp(-away * away) * np.float32(1 / (np.sqrt(2 * np.pi) * self.blur))
        residual = self.residual
        if change.any():
            moved = np.matmul(self.jacobian, change[:, :, None].astype(np.float32))
            residual = residual + moved * gradient
        weighted = residual * np.float32(1 / self.cauchy)
        weighted *= weighted
        weighted += 1
        np.divide(self.weight, weighted, out=weighted)
        weighted *= gradient
        across = weighted @ gradient
        along = np.einsum("cnk,cnk->cn", weighted, residual)
        transposed = self.jacobian.swapaxes(1, 2)
        information = np.matmul(transposed, self.jacobian * across[:, :, None])
        slope = np.matmul(transposed, along[:, :, None])[:, :, 0]
        symmetric = (information + information.swapaxes(1, 2)).astype(np.float64) / 2
        return symmetric, slope.astype(np.float64)

    def share_that_holds(self, change: Float64) -> Float64:
        """Return the share (C,) of each change (C, D) up to which no outline point leaves the profile's middle."""
        moved = np.matmul(self.jacobian, change[:, :, None].astype(np.float32))
        largest = np.asarray(np.abs(moved[:, :, 0]).max(axis=1), dtype=np.float64)
        return np.minimum(1, _LARGEST_SHIFT / np.maximum(largest, 1e-12))
