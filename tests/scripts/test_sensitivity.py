"""scripts/sensitivity.py: constants are changed everywhere, tried in processes of their own, and kept in a table."""

from __future__ import annotations

import os
import pickle
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.segment import Segmentation

if TYPE_CHECKING:
    from measure.pictures import Picture

pytestmark = pytest.mark.usefixtures("scripts_on_path")


class Pair(NamedTuple):
    a: float
    b: str


@dataclass(frozen=True)
class Steps:
    count: int
    tolerance: float = 0.1


@pytest.mark.parametrize(
    ("value", "doubled"),
    [
        (0.25, 0.5),
        (3, 6),
        (True, True),
        ("3", "3"),
        (None, None),
        ((1, 2.0), (2, 4.0)),
        ([1], [2]),
        ({"x": 1.5}, {"x": 3.0}),
        (Pair(1.5, "x"), Pair(3.0, "x")),
        (Steps(2), Steps(4, 0.2)),
    ],
)
def test_numbers_of_a_value_are_scaled(value: object, doubled: object) -> None:
    from sensitivity import scaled

    assert scaled(value, 2.0) == doubled


def test_whole_numbers_stay_whole_and_at_least_one() -> None:
    from sensitivity import scaled

    assert [scaled(each, 0.5) for each in (5, 1, 0, -4)] == [2, 1, 0, -2]
    np.testing.assert_array_equal(scaled(np.array([1.0, 3.0]), 0.5), [0.5, 1.5])


def test_changes_name_every_constant_of_a_package() -> None:
    from sensitivity import changes

    found = [each for each in changes(["evidence"], [2.0]) if each.module == "evidence/shaft_edges.py"]
    assert {each.changed[0] for each in found} >= {"_FACING"}
    assert [each.value for each in found if each.name == "_FACING"] == ["0.93"]
    assert [*changes(["evidence/shaft_edges.py"], [2.0])] == found


def test_changed_constant_is_changed_where_it_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    from sensitivity import Changed, put

    limit = 0.123
    home, user, other = (ModuleType(f"dvrk_cmaes.made_{name}") for name in ("home", "user", "other"))
    for module in (home, user, other):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    home.LIMIT = user.LIMIT = limit  # type: ignore[attr-defined]
    other.LIMIT = 7.0  # type: ignore[attr-defined]
    put(Changed("made_home.py", "LIMIT", "0.123", ("LIMIT", 1.0)))
    assert (home.LIMIT, user.LIMIT, other.LIMIT) == (1.0, 1.0, 7.0)  # type: ignore[attr-defined]


def test_change_that_ends_a_run_is_named_by_its_error() -> None:
    from sensitivity import Data, Figures, tried

    class Made(Data):
        def run(self) -> Figures:
            raise ValueError("expected more\nand more")

    class Slow(Data):
        def run(self) -> Figures:
            import time

            time.sleep(60)
            raise AssertionError

    class Well(Data):
        def run(self) -> Figures:
            return Figures(1, 1, 0, 0.5, 1.0)

    body = None
    assert tried(Made((), (), body), None, 60) == "ValueError: expected more"  # type: ignore[arg-type]
    assert str(tried(Slow((), (), body), None, 0.2)).startswith("took more than")  # type: ignore[arg-type]
    assert tried(Well((), (), body), None, 60) == Figures(1, 1, 0, 0.5, 1.0)  # type: ignore[arg-type]


def test_processes_that_a_changed_run_starts_are_told_the_change() -> None:
    from sensitivity import Changed, Data, Figures, tried

    change = Changed("evidence/shaft_edges.py", "_FACING", "0.93", ("_FACING", 0.5))

    class Made(Data):
        def run(self) -> Figures:
            told = pickle.loads(bytes.fromhex(os.environ["DVRK_CMAES_SENSITIVITY_CHANGE"]))
            return Figures(int(told == tuple(change)), 0, 0, 0.0, 0.0)

    assert tried(Made((), (), None), change, 60) == (1, 0, 0, 0, 0)  # type: ignore[arg-type]
    assert "DVRK_CMAES_SENSITIVITY_CHANGE" not in os.environ


def test_masks_of_pictures_are_compared_with_the_true_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    import sensitivity
    from sensitivity import find_masks, shown_in

    shown = shown_in(bundled_path("demo"), "lnd", 2)
    assert [path.parent.name for path in shown.images["left"]].count("images") >= 2
    first, second = shown.pictures
    found = {
        first.name: Segmentation(first.tools[0], confidence=0.9),
        second.name: Segmentation(np.zeros_like(second.tools[0]), confidence=0.95),
    }

    def found_in(picture: Picture, *_: object) -> SimpleNamespace:
        return SimpleNamespace(segmentation=found[picture.name])

    monkeypatch.setattr(sensitivity, "found_in", found_in)
    assert find_masks([shown])[:4] == (1, 2, 1, 0.5)


def test_rows_take_the_place_of_older_ones_of_the_same_data(tmp_path: Path) -> None:
    from measure.constants import Row, measured, read_table, write_table

    def row(name: str, value: str, data: str) -> Row:
        return Row(
            "a/b.py", name, value, f"{name} = 2", "1 (1)", "1 (1)", "0 (0)", "0.1 (0.1)", "1 (1)", "", data, "abc"
        )

    path = tmp_path / "table.csv"
    assert read_table(path) == []
    write_table([row("_A", "1", "x"), row("_B", "(1, 2)", "x")], path)
    write_table([row("_A", "3", "x"), row("_A", "1", "y")], path)
    assert {(each.constant, each.value, each.data) for each in read_table(path)} == {
        ("_A", "3", "x"),
        ("_A", "1", "y"),
        ("_B", "(1, 2)", "x"),
    }
    assert measured(read_table(path))["a/b.py", "_A"] == {"1", "3"}
