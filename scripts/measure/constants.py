"""Numeric constants of modules, and the table of what changes of them do to answers."""

from __future__ import annotations

import ast
import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from dvrk_cmaes.io.atomic import write_text

TABLE: Final = Path(__file__).with_name("sensitivity.csv")


class Constant(NamedTuple):
    """An assignment of numbers at the top level of a module: the name, its expression, and how many numbers it has."""

    name: str
    value: str
    numbers: int


class Row(NamedTuple):
    """What a changed constant does: its module's path in dvrk_cmaes, its value and the changed one, and figures.

    Figures are texts ``NEW (OLD)``: of the images with a truth those in the right place, ok, and ok but wrong; how far
    they are off, the median error of the tips, mm, or of pictures the mean of 1 - IoU of their masks; seconds of
    processor time. ``error`` ends a run without figures.
    """

    module: str
    constant: str
    value: str
    changed: str
    right: str
    ok: str
    wrong: str
    off: str
    seconds: str
    error: str
    data: str
    commit: str


def constants_in(body: Sequence[ast.stmt]) -> Iterator[Constant]:
    """Yield the assignments of a module's statements that have numbers."""
    for node in body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        numbers = [one for one in ast.walk(node.value) if isinstance(one, ast.Constant)]
        count = sum(type(one.value) in (int, float) for one in numbers)
        if count:
            name = node.targets[0] if isinstance(node, ast.Assign) else node.target
            yield Constant(ast.unparse(name), ast.unparse(node.value), count)


def read_table(path: Path = TABLE) -> list[Row]:
    """Read the rows of the table; none if there is no file."""
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [Row(**row) for row in csv.DictReader(file)]


def write_table(rows: Sequence[Row], path: Path = TABLE) -> None:
    """Put rows into the table, in the place of older ones of the same constants and data."""
    new = {(row.module, row.constant, row.data) for row in rows}
    kept = [row for row in read_table(path) if (row.module, row.constant, row.data) not in new]
    lines = [Row._fields, *sorted([*kept, *rows])]
    write_text(path, "".join(",".join(map(_cell, line)) + "\n" for line in lines))


def measured(rows: Sequence[Row]) -> Mapping[tuple[str, str], set[str]]:
    """Return the measured values of each constant, by its module and name."""
    found: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        found.setdefault((row.module, row.constant), set()).add(row.value)
    return found


def _cell(text: str) -> str:
    """Return a cell of a CSV line, quoted where needed."""
    return f'"{text.replace(chr(34), chr(34) * 2)}"' if set(text) & set('",\n') else text
