"""The interface of a term: a sum of squares that a pose should make small, and its approximation near a pose."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import Float64, Posed


class Approximation(ABC):
    """A term near C poses, as a function of small changes (C, D) of these."""

    @abstractmethod
    def normal_equations(self, change: Float64) -> tuple[Float64, Float64]:
        """Return the information (C, D, D) and the slope (C, D) of half the sum of squares after changes (C, D)."""


@dataclass(frozen=True, eq=False)
class Quadratic(Approximation):
    """The quadratic approximation of half a sum of squares: ``information`` (C, D, D) and ``slope`` (C, D)."""

    information: Float64
    slope: Float64

    @staticmethod
    def zero(count: int, dimension: int) -> Quadratic:
        """Return that of a term that is zero everywhere, for C = ``count`` poses and D = ``dimension`` changes."""
        return Quadratic(np.zeros((count, dimension, dimension)), np.zeros((count, dimension)))

    def __add__(self, other: Quadratic) -> Quadratic:
        """Return that of the sum of two terms."""
        return Quadratic(self.information + other.information, self.slope + other.slope)

    def times(self, factors: Float64) -> Quadratic:
        """Return that of the term near each pose times a factor, (C,)."""
        return Quadratic(factors[:, None, None] * self.information, factors[:, None] * self.slope)

    def moved_by(self, change: Float64) -> Quadratic:
        """Return the same about where one pose is after a change (K,) of its first unknowns."""
        return replace(self, slope=self.slope + self.information[:, :, : len(change)] @ change)

    @property
    def dimension(self) -> int:
        """Number D of small changes."""
        return int(self.slope.shape[-1])

    def select(self, index: Sequence[int] | NDArray[np.integer]) -> Self:
        """Return that near some of the poses."""
        chosen = np.asarray(index)
        return replace(self, information=self.information[chosen], slope=self.slope[chosen])

    @classmethod
    def joined(cls, groups: Sequence[Self]) -> Self:
        """Return those near several groups of poses together."""
        return cls(
            np.concatenate([group.information for group in groups]), np.concatenate([group.slope for group in groups])
        )

    def normal_equations(self, change: Float64) -> tuple[Float64, Float64]:
        """Return information and slope after changes, as of `Approximation`."""
        return self.information, self.slope + np.einsum("cij,cj->ci", self.information, change)


class Term(ABC):
    """A sum of squares in units of its standard deviations, as a function of a pose.

    Small changes (D,), D = 6 + J, are those of `Posed`.
    """

    @abstractmethod
    def cost(self, at: Posed) -> Float64:
        """Return the sum of squares (C,) at C poses."""

    @abstractmethod
    def local(self, at: Posed) -> Quadratic:
        """Return the approximation of half the sum of squares near C poses, by Gauss and Newton."""

    def allowed(self, at: Posed) -> Posed:
        """Return the poses within what the term allows at all; by default, it allows everything."""
        return at


def sum_of_costs(terms: Iterable[Term], at: Posed) -> Float64:
    """Return the sum of the terms' sums of squares (C,) at C poses."""
    return sum((term.cost(at) for term in terms), start=np.zeros(len(at)))


def sum_of_locals(terms: Iterable[Term], at: Posed) -> Quadratic:
    """Return the approximation of half the sum of the terms' sums of squares near C poses."""
    zero = Quadratic.zero(len(at), 6 + at.joints.shape[1])
    return sum((term.local(at) for term in terms), start=zero)
