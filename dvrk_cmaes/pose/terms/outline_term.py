"""The interface of terms of the outline: what is drawn at a pose serves its value and its derivatives."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Generic, Literal, TypeVar

from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.pose.terms.term import Approximation

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
