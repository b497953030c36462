"""Scores of submissions by the one scorer, ranks, and the table of the page data/reference/benchmark.md."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from worlds.motion import instrument_of

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import write_text
from measuring.benchmark.submission import Key, Row
from measuring.benchmark.tasks import BASE, Given, TaskName
from measuring.report import ROOT, markdown
from measuring.scorer import Scored, figures, is_wrong, score_base, scored

PAGE: Final = ROOT / "data" / "reference" / "benchmark.md"
COLUMNS: Final[Mapping[str, str]] = {
    "task": "{}",
    "rank": "{}",
    "method": "`{}`",
    "frames": "{}",
    "ok": "{:.0%}",
    "ok and wrong": "{}",
    "recordings wrong": "{}",
    "error, mm": "{:.3g}",
    "95 %, mm": "{:.3g}",
    "worst ok, mm": "{:.3g}",
    "shaft, deg": "{:.2g}",
    "joints, deg": "{:.2g}",
    "90 % intervals": "{:.0%}",
    "processor s a row": "{:.2g}",
}
"""Columns of the table in the page, and their formats."""
_TABLE: Final = re.compile(r"^\| task \| rank .*\n(?:\|.*\n)+", re.MULTILINE)


@dataclass(frozen=True)
class Scores:
    """A task of a world, its scored frames, and the processor time of each row, s."""

    given: Given
    frames: tuple[Scored, ...]
    seconds: tuple[float, ...]


def score_world(given: Given, rows: Mapping[str, Row]) -> Scores:
    """Score the rows of a task in a world, by frame; InputError if a row's frame is not one of the task."""
    strangers = sorted(set(rows) - set(given.frames))
    if strangers:
        place = f"task {given.task}, world {given.world.number}"
        raise InputError(f"{place}: frame: expected one of {given.frames[0]} to {given.frames[-1]}, got {strangers[0]}")
    documents = {name: row.stated for name, row in rows.items() if row.stated.get("camera_from_root") is not None}
    if given.task == BASE:
        base = {**documents[BASE], "camera_from_base": documents[BASE]["camera_from_root"]} if documents else None
        frames: tuple[Scored, ...] = (score_base(base, given.drawn.camera_from_base())[0],)
    else:
        golden, focal = given.drawn.golden(), given.world.camera.fx
        frames = tuple(scored(instrument_of(given.world.instrument), documents, golden, focal))
    return Scores(given, frames, tuple(row.stated["seconds"] for row in rows.values() if row.stated.get("seconds")))


def score_submission(givens: Sequence[Given], rows: Mapping[Key, Row]) -> dict[TaskName, list[Scores]]:
    """Score a submission in the tasks that it has rows of, in all of the given worlds of these.

    Raises
    ------
    InputError
        A row is of a task, world or frame that is not given.
    """
    known = {(given.task, given.world.number) for given in givens}
    for task, world, _ in rows:
        if (task, world) not in known:
            raise InputError(f"world: expected one of those drawn for the task {task}, got {world}")
    tried = {task for task, _, _ in rows}
    out: dict[TaskName, list[Scores]] = {}
    for given in givens:
        if given.task in tried:
            place = given.task, given.world.number
            own = {row.frame: row for row in rows.values() if (row.task, row.world) == place}
            out.setdefault(given.task, []).append(score_world(given, own))
    return out


def score_row(method: str, task: TaskName, scores: Sequence[Scores]) -> dict[str, Any]:
    """Return the row of the table for a method in a task, over its worlds."""
    found = figures([frame for each in scores for frame in each.frames])
    seconds = [value for each in scores for value in each.seconds]
    alone = task in ("frame", BASE)
    return {
        "task": task,
        "method": method,
        "worlds": len(scores),
        "frames": found["frames"],
        "ok": found["ok"] / max(found["frames"], 1),
        "ok and wrong": found["ok and wrong"],
        "recordings wrong": None if alone else sum(is_wrong(each.frames) for each in scores),
        "right mode": found["right mode"],
        "error, mm": found["tips, mm"],
        "95 %, mm": found["95 %"],
        "worst ok, mm": found["worst ok"],
        "shaft, deg": found["shaft, deg"],
        "joints, deg": found["joints, deg"],
        "90 % intervals": found["90 % intervals"],
        "90 % regions": found["90 % regions"],
        "processor s a row": sum(seconds) / len(seconds) if seconds else None,
    }


def ranked(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of the table by task and rank, that of the median error; equal errors have the same rank."""
    out: list[dict[str, Any]] = []
    for task in dict.fromkeys(row["task"] for row in rows):
        own = sorted((row for row in rows if row["task"] == task), key=lambda row: float(row["error, mm"]))
        for row in own:
            out.append({"task": task, "rank": 1 + sum(o["error, mm"] < row["error, mm"] for o in own), **row})
    return out


def write_table(rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the table into the page; InputError if that has none."""
    cells = [["-" if row[n] is None else form.format(row[n]) for n, form in COLUMNS.items()] for row in rows]
    table = markdown([*COLUMNS], cells) + "\n"
    text, count = _TABLE.subn(lambda _: table, PAGE.read_text(encoding="utf-8"), count=1)
    if not count:
        raise InputError(f"{PAGE}: expected a table whose header begins with | task | rank, got none")
    write_text(PAGE, text)
