"""The loss of the coverage as a function of small changes of a pose, from samples of the difference along the outline.

The difference of blurred coverage and blurred mask is sampled along the normal of each outline point. If the point
moves outwards by e px, the blurred coverage s px outside its present place becomes larger by e times the density of the
normal distribution at s whose standard deviation is that of the blur. The sum of the robust loss over all samples is
therefore a function of the change of the pose that needs no further silhouettes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dvrk_cmaes import _kernel
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.terms.sized_view import REACH
from dvrk_cmaes.pose.terms.term import Approximation


def density(blur: float) -> list[float]:
    """Return the change of each sample by a displacement of the outline, 1/px, for a blur, px."""
    away = np.arange(-REACH, REACH + 1) / (np.sqrt(2) * blur)
    return [float(value) for value in np.exp(-away * away) / (np.sqrt(2 * np.pi) * blur)]


@dataclass(frozen=True, eq=False)
class Profiles(Approximation):
    """The samples of C poses in V views: those of the views of the first pose, drawn with outlines, come first.

    factors : (V,) of the views' losses. density : as `density`. cauchy : width of the robust loss.
    """

    compared: Sequence[_kernel.Comparison]
    factors: Sequence[float]
    density: Sequence[float]
    cauchy: float

    def normal_equations(self, change: Float64) -> tuple[Float64, Float64]:
        """Compute information (C, D, D) and slope (C, D) of the robust loss at changes (C, D) of the poses.

        They are in sums of squares of coverage, with the weights of the Cauchy loss at the changed poses.
        """
        return _kernel.normal_equations(self.compared, self.factors, self.density, self.cauchy, change)
