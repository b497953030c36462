"""Values as documents: what becomes of each kind of value, and which digits are kept."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np

from dvrk_cmaes.io.encode import SIGNIFICANT, encoded, encoded_fields


@dataclass(frozen=True)
class Part:
    value: float
    names: tuple[str, ...] = ("a", "b")


@dataclass(frozen=True, eq=False)
class Whole:
    part: Part | None
    at: np.ndarray
    spread: np.ndarray = field(metadata=SIGNIFICANT)
    count: int = 3
    right: bool = True


def test_numbers_are_rounded_to_nine_decimals_and_whole_numbers_stay() -> None:
    assert encoded(1.23456789012e-3) == 0.001234568
    assert encoded(np.float64(0.1) + 0.2) == 0.3
    assert json.dumps(encoded([3, True, None, "a"])) == '[3, true, null, "a"]'


def test_parts_of_documents_are_encoded_in_the_order_of_their_fields() -> None:
    whole = Whole(Part(1 / 3), np.array([[1 / 3, 2.0]]), np.array([[1.23456789e-12]]))
    document = encoded(whole)
    assert list(document) == ["part", "at", "spread", "count", "right"]
    assert document["part"] == {"value": 0.333333333, "names": ["a", "b"]}
    assert document["at"] == [[0.333333333, 2.0]]
    assert document["spread"] == [[1.234568e-12]]  # nine decimals would be zero


def test_some_fields_are_encoded_in_the_order_that_is_asked_for() -> None:
    whole = Whole(None, np.zeros(1), np.eye(1))
    assert encoded_fields(whole, "right", "part") == {"right": True, "part": None}


def test_mappings_keep_their_order() -> None:
    assert list(encoded({"b": 1 / 3, "a": (1 / 3,)}).items()) == [("b", 0.333333333), ("a", [0.333333333])]
