"""Values as messages show them."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from dvrk_cmaes.io.short_text import listed, shown


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "nothing"),
        ("a\nb", "'a\\nb'"),
        ("x" * 1000, "'" + "x" * 56 + "..."),
    ],
)
def test_value_is_shown_on_one_short_line(value: Any, text: str) -> None:
    assert shown(value) == text


def test_integer_of_many_digits_is_shown() -> None:
    assert shown(10 ** (2 * sys.get_int_max_str_digits())) == "a value of type int that is too large to show"


def test_value_of_many_levels_is_shown() -> None:
    nested: list[Any] = []
    for _ in range(100_000):
        nested = [nested]
    assert shown(nested) == "a value of type list that is too large to show"


def test_first_names_are_listed() -> None:
    assert listed(["a", "b\n"]) == "a, b\\n"
    assert listed("abcdef") == "a, b, c, d, e, ..."
