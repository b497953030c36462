"""The table and the plots of the page data/reference/benchmark.md, from the scores of a run."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from measure.places import ROOT

from benchmark.score import LEVELS
from dvrk_cmaes.draw.figure import new_figure, write_figure
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.io.json_file import read_json_object

DATA: Final = ROOT / "data"
COLUMNS: Final[Mapping[str, str]] = {
    "task": "{}",
    "rank": "{}",
    "method": "`{}`",
    "frames": "{}",
    "ok": "{:.0%}",
    "ok and wrong": "{}",
    "recordings wrong": "{}",
    "error, mm": "mm",
    "95 %, mm": "mm",
    "worst ok, mm": "mm",
    "shaft, deg": "{:.2g}",
    "joints, deg": "{:.2g}",
    "90 % intervals": "{:.0%}",
    "processor s a row": "{:.2g}",
}
"""Columns of the table in the page, and their formats; ``mm`` is that of millimetres."""
_TABLE: Final = re.compile(r"^\| task \| rank .*\n(?:\|.*\n)+", re.MULTILINE)


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as the table of the page."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "| " + " | ".join("---" for _ in COLUMNS) + " |"]
    for row in rows:
        cells = ["-" if row[name] is None else _cell(row[name], form) for name, form in COLUMNS.items()]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _cell(value: Any, form: str) -> str:
    """Format a cell; of millimetres three digits are significant."""
    if form == "mm":
        return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
    return form.format(value)


def write_page(scores: Path, data: Path = DATA) -> list[Path]:
    """Write the table into the page, the plots, and the figures of both; return the files that were written.

    Raises
    ------
    InputError
        The scores are missing, or the page has no table.
    """
    found = read_json_object(scores, expected="the scores of a run (scores.json)")
    page = data / "reference" / "benchmark.md"
    text, count = _TABLE.subn(lambda _: markdown(found["table"]), page.read_text(encoding="utf-8"), count=1)
    if not count:
        raise InputError(f"{page}: expected a table whose header begins with | task | rank, got none")
    written = [data / "docs" / f"benchmark_{name}" for name in ("time.png", "reliability.png", "figures.json")]
    _plot_time(written[0], found["table"])
    _plot_reliability(written[1], found["reliability"])
    write_text(written[2], json.dumps(_short({name: found[name] for name in ("given", "table", "reliability")})) + "\n")
    write_text(page, text)
    return [page, *written]


def _short(value: Any) -> Any:
    """Round the numbers in a document to six significant digits."""
    if isinstance(value, Mapping):
        return {name: _short(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_short(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _plot_time(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Plot the median error of each method in each task against its processor time."""
    figure = new_figure(6, 3.6)
    axes = figure.subplots()
    for task in dict.fromkeys(row["task"] for row in rows):
        own = [row for row in rows if row["task"] == task and row["processor s a row"]]
        axes.loglog(*zip(*[(row["processor s a row"], row["error, mm"]) for row in own], strict=True), "o", label=task)
        for row in own:
            place = (row["processor s a row"], row["error, mm"])
            axes.annotate(row["method"], place, xytext=(4, 4), textcoords="offset points", fontsize=7)
    axes.set(xlabel="processor time a row, s", ylabel="median error, mm")
    axes.margins(x=0.15)
    axes.grid(visible=True, which="both", alpha=0.2)
    axes.legend(fontsize=7)
    write_figure(path, figure)


def _plot_reliability(path: Path, curves: Mapping[str, Sequence[float] | None]) -> None:
    """Plot how many of the intervals of a probability contain the truth, of the methods that state any."""
    figure = new_figure(4.6, 3.9)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], "k:", linewidth=1)
    for name, curve in curves.items():
        if curve is not None:
            axes.plot(LEVELS, curve, "o-", markersize=3, linewidth=1, label=name)
    axes.set(xlabel="stated probability of the interval", ylabel="share that contains the truth", xlim=(0, 1))
    axes.set_ylim(0, 1)
    axes.legend(fontsize=6)
    write_figure(path, figure)


def figures(data: Path = DATA) -> dict[str, Any]:
    """Return the figures that the page was made from."""
    found: dict[str, Any] = json.loads((data / "docs" / "benchmark_figures.json").read_text(encoding="utf-8"))
    return found
