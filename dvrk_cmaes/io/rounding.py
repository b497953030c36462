"""Round numbers before they are written to documents, so that files are the same on every run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dvrk_cmaes.geometry import Float64


def rounded(value: float) -> float:
    """Round to nine decimals: a nanometre or a nanoradian."""
    return round(float(value), 9)


def rounded_values(values: Mapping[str, float]) -> dict[str, float]:
    """Round the numbers of a mapping as `rounded` does."""
    return {name: rounded(value) for name, value in values.items()}


def rounded_array(array: Float64) -> Any:
    """Round an array as `rounded` does, to nested lists."""
    return np.round(np.asarray(array, dtype=np.float64), 9).tolist()


def rounded_matrix(matrix: Float64) -> list[list[float]]:
    """Round the numbers of a covariance to seven significant digits."""
    return [[float(f"{value:.6e}") for value in row] for row in matrix]
