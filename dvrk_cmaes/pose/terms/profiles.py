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

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.pose.terms.term import Approximation
from dvrk_cmaes.silhouette import OutlinePoints
from dvrk_cmaes.silhouette.moving_points import joined

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_REACH = 4  # px from the outline to which the residual is sampled
_LARGEST_SHIFT = 3.0  # px; beyond it an outline has left the profile that was sampled


@dataclass(frozen=True, eq=False)
class Profiles(Approximation):
    """Samples of residuals along the normals of C outlines, N points in all, K samples per point.

    begin : (C + 1,) offsets of the points of each outline. residual : (N, K) blurred coverage less blurred mask.
    weight : (N, K) px of outline that the sample stands for, 0 at ignored pixels. jacobian : (N, D) of the displacement
    of the points along their unit normals, px. density : (K,) change of the residual by such a displacement, 1/px.
    cauchy : width of the robust loss.
    """

    begin: NDArray[np.int64]
    residual: Float32
    weight: Float32
    jacobian: Float64
    density: Float64
    cauchy: float

    @classmethod
    def sampled(
        cls,
        images: Sequence[Float32],
        target: Float32,
        weight: Float32,
        outlines: Sequence[OutlinePoints],
        jacobians: Sequence[Float64],
        blur: float,
        cauchy: float,
    ) -> Profiles:
        """Sample C images (H, W) less their ``target`` (H, W) at the points of C outlines.

        ``jacobians`` (N, D) are of the displacements times the lengths of outline that the points represent;
        ``weight`` (H, W) is that of the pixels; ``blur``, px, that of the images and the target.
        """
        begin = np.cumsum([0, *(len(outline.link) for outline in outlines)], dtype=np.int64)
        normals = joined(outlines, "normals")
        residual, shares = _kernel.sample_profiles(
            images, target, weight, begin, joined(outlines, "pixels"), normals, _REACH
        )
        away = np.arange(-_REACH, _REACH + 1) / (np.sqrt(2) * blur)
        density = np.exp(-away * away) / (np.sqrt(2 * np.pi) * blur)
        jacobian = np.concatenate(jacobians) / np.linalg.norm(normals, axis=1)[:, None]
        return cls(begin, residual, shares, jacobian, density, cauchy)

    @property
    def count(self) -> int:
        """Number C of poses."""
        return len(self.begin) - 1

    @property
    def dimension(self) -> int:
        """Number D of small changes."""
        return int(self.jacobian.shape[1])

    def select(self, index: Sequence[int]) -> Self:
        """Return the profiles of some of the outlines."""
        return self.joined([self._of(i) for i in index])

    @classmethod
    def joined(cls, groups: Sequence[Self]) -> Self:
        """Return the profiles of several groups of outlines together; those of a single group are not copied."""
        if len(groups) == 1:
            return groups[0]
        lengths = np.concatenate([np.diff(group.begin) for group in groups])
        return replace(
            groups[0],
            begin=np.concatenate([[0], np.cumsum(lengths)]),
            residual=np.concatenate([group.residual for group in groups]),
            weight=np.concatenate([group.weight for group in groups]),
            jacobian=np.concatenate([group.jacobian for group in groups]),
        )

    @staticmethod
    def of_views(views: Sequence[Profiles], factors: Sequence[float]) -> Profiles:
        """Return the profiles of the same poses in several views as one, with the loss of each times its factor.

        The changes of the poses have the same axes in every view, and the views the same blur.
        """
        if len(views) == 1:
            return views[0]
        scaled = [replace(view, weight=view.weight * np.float32(f)) for view, f in zip(views, factors, strict=True)]
        together = Profiles.joined([view._of(i) for i in range(views[0].count) for view in scaled])
        return replace(together, begin=together.begin[:: len(views)].copy())

    def _of(self, index: int) -> Self:
        """Return the profiles of one outline."""
        begin, end = self.begin[index : index + 2].tolist()
        part = slice(begin, end)
        return replace(
            self,
            begin=np.array([0, end - begin]),
            residual=self.residual[part],
            weight=self.weight[part],
            jacobian=self.jacobian[part],
        )

    def normal_equations(self, change: Float64) -> tuple[Float64, Float64]:
        """Compute information (C, D, D) and slope (C, D) of the robust loss at changes (C, D) of the poses.

        They are in sums of squares of coverage, with the weights of the Cauchy loss at the changed poses.
        """
        return _kernel.normal_equations(
            self.begin, self.residual, self.weight, self.jacobian, self.density, self.cauchy, change
        )

    def share_that_holds(self, change: Float64) -> Float64:
        """Return the share (C,) of each change (C, D) up to which no outline point leaves the profile's middle."""
        of_points = np.repeat(change, np.diff(self.begin), axis=0)
        moved = np.abs(np.einsum("nd,nd->n", self.jacobian, of_points))
        largest = np.zeros(self.count)
        np.maximum.at(largest, np.repeat(np.arange(self.count), np.diff(self.begin)), moved)
        return np.minimum(1, _LARGEST_SHIFT / np.maximum(largest, 1e-12))
