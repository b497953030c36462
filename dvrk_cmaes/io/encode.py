"""Values as documents: what JSON has, with numbers rounded, so that files are the same on every run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.geometry import Float64

SIGNIFICANT: Final = {"significant": True}
"""Metadata of a field with a matrix whose numbers are rounded to significant digits, as those of covariances."""


def encoded(value: Any) -> Any:
    """Return a value as JSON has it.

    What has a document of its own becomes that, other dataclasses and mappings become mappings, sequences and arrays
    lists; numbers that are not whole are rounded to nine decimals.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, np.ndarray):
        return rounded_array(value)
    if isinstance(value, float):
        return rounded(value)
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if is_dataclass(value):
        return encoded_fields(value, *(field.name for field in fields(value)))
    if isinstance(value, Mapping):
        return {name: encoded(part) for name, part in value.items()}
    return [encoded(part) for part in value]


def encoded_fields(value: Any, *names: str) -> dict[str, Any]:
    """Return some fields of a dataclass, in the order of their names, as JSON has them."""
    matrices = {field.name for field in fields(value) if field.metadata.get("significant")}
    parts = {name: getattr(value, name) for name in names}
    return {name: rounded_matrix(part) if name in matrices else encoded(part) for name, part in parts.items()}


class Document:
    """A dataclass whose fields are a document, in their order."""

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON has them."""
        return encoded_fields(self, *(field.name for field in fields(self)))  # type: ignore[arg-type]  # of a dataclass


def rounded(value: float) -> float:
    """Round to nine decimals, a nanometre or a nanoradian, with 0.0 for -0.0."""
    return round(float(value), 9) + 0.0


def rounded_values(values: Mapping[str, float]) -> dict[str, float]:
    """Round the numbers of a mapping as `rounded` does."""
    return {name: rounded(value) for name, value in values.items()}


def rounded_array(array: Float64) -> Any:
    """Round an array as `rounded` does, to nested lists."""
    return (np.round(np.asarray(array, dtype=np.float64), 9) + 0.0).tolist()


def rounded_matrix(matrix: Float64) -> list[list[float]]:
    """Round the numbers of a covariance to seven significant digits."""
    return [[float(f"{value:.6e}") for value in row] for row in matrix]
