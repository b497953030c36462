"""Cells of the tables that are written: texts are never formulas, numbers stay numbers."""

from __future__ import annotations

import pytest

from dvrk_cmaes.io.csv_file import csv_text


@pytest.mark.parametrize("name", ["=2+2", "@SUM(A1)", "+cmd", "-a"])
def test_name_that_looks_like_a_formula_is_a_text(name: str) -> None:
    assert csv_text(["frame", "x"], [[name, -1.5]]) == f"frame,x\n'{name},-1.5\n"


@pytest.mark.parametrize("value", ["-1.5", "+2", -3, None, "0001"])
def test_numbers_and_usual_names_stay_as_they_are(value: object) -> None:
    assert csv_text(["x"], [["a", value]]) == f"x\na,{'' if value is None else value}\n"
