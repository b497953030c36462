"""The command `measure.py benchmark`: tasks, the methods that solve them, scores, and seeds that are kept."""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from worlds.table import VALUES

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import write_json, write_text
from measuring.benchmark.methods import METHODS, OURS, rows_of_method
from measuring.benchmark.score import ranked, score_row, score_submission, write_table
from measuring.benchmark.submission import Row, read_submission, write_submission
from measuring.benchmark.tasks import FRAMES, KEPT, SEED, TASKS, Given, TaskName, digest, given_task, set_name, table
from measuring.report import Report, in_processes

PARAMETERS: Final = (*VALUES,)
SCORES: Final = "scores.json"
"""File of a folder's scores."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("what", choices=("run", "draw", "score", "keep"), help="what to do")
    parser.add_argument(
        "paths", nargs="+", type=Path, metavar="PATH", help="the folder (of keep a new file), submissions"
    )
    parser.add_argument("--worlds", type=int, default=20, metavar="N", help="the first N worlds (default: %(default)s)")
    parser.add_argument("--numbers", metavar="N,...", help="numbers of worlds of the table, instead of the first ones")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="seed of the worlds (default: %(default)s)")
    parser.add_argument("--tasks", default=",".join(TASKS), metavar="T,...", help="tasks (default: %(default)s)")
    parser.add_argument(
        "--methods",
        default="ours",
        metavar="M,...",
        help=f"methods of run: some of {', '.join(METHODS)}; ours: {', '.join(OURS)} (default: %(default)s)",
    )
    parser.add_argument("--session-frames", type=int, default=FRAMES["session"], metavar="N", help="frames of sessions")
    parser.add_argument(
        "--recording-frames", type=int, default=FRAMES["recording"], metavar="N", help="frames of recordings"
    )
    parser.add_argument("--by-value", action="store_true", help="print rows by value of each parameter of the worlds")
    parser.add_argument("--page", action="store_true", help="write the table into data/reference/benchmark.md")


def benchmark_report(options: argparse.Namespace) -> Report:
    """Do what is asked for, and return its table."""
    folder, *submissions = options.paths
    if options.what == "keep":
        if folder.exists():
            raise InputError(f"keep: expected the name of a new file, got {folder}")
        seeds = [str(secrets.randbits(128)) for _ in KEPT]
        write_text(folder, "".join(f"{seed}\n" for seed in seeds))
        return {"SHA-256": [{"seed": number, "sha256": digest(seed)} for number, seed in enumerate(seeds, 1)]}
    if folder.is_file():
        raise InputError(f"{options.what}: expected a folder, got {folder}")
    if options.what == "run":
        submissions = _run(folder, options)
    elif options.what == "score" and not submissions:
        raise InputError("score: expected submissions (JSON Lines) after the folder, got none")
    givens = [
        one for number in _numbers(options) for task in _tasks(options) for one in _given(folder, options, number, task)
    ]
    if options.what == "draw":
        return {"given": [{"task": o.task, "world": o.world.number, "folder": str(o.given.path)} for o in givens]}
    rows, worlds, values = [], [], []
    for path in submissions:
        try:
            by_task = score_submission(givens, read_submission(path))
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        for task, scores in by_task.items():
            rows.append(score_row(path.stem, task, scores))
            worlds += [{"world": s.given.world.number, **score_row(path.stem, task, [s])} for s in scores]
            for name in PARAMETERS:
                known = [(s.given.world.describe()[name], s) for s in scores]
                for value in dict.fromkeys(value for value, _ in known):
                    row = score_row(path.stem, task, [s for own, s in known if own == value])
                    values.append({"parameter": name, "value": value, **row})
    report: dict[str, Any] = {"table": ranked(rows), "by world": worlds}
    if options.by_value:
        report["by value of a parameter"] = values
    write_json(folder / SCORES, {**report, "given": {"seed": options.seed, "worlds": _numbers(options)}})
    if options.page:
        write_table(report["table"])
    return report


def _run(folder: Path, options: argparse.Namespace) -> list[Path]:
    """Draw and solve; write and return the submission of each method."""
    names = [name for each in options.methods.split(",") for name in (OURS if each == "ours" else [each])]
    _known("--methods", names, METHODS)
    chosen = [(method, task) for method in names for task in METHODS[method][0] if task in _tasks(options)]
    jobs = [(folder, options, world, chosen) for world in _numbers(options)]
    found = [pair for each in in_processes(_one_world, jobs, options.workers, "worlds") for pair in each]
    for method in names:
        rows = sorted((row for name, row in found if name == method), key=lambda row: row.key)
        write_submission(folder / f"{method}.jsonl", rows)
    return [folder / f"{method}.jsonl" for method in names]


def _one_world(
    folder: Path, options: argparse.Namespace, number: int, chosen: Sequence[tuple[str, TaskName]]
) -> list[tuple[str, Row]]:
    """Solve a world by methods, each in a task; return the rows with the name of the method."""
    out = folder / "solved" / set_name(options.seed) / f"{number:03d}"
    return [
        (method, row)
        for method, task in chosen
        for given in _given(folder, options, number, task)
        for row in rows_of_method(method, given, out)
    ]


def _given(folder: Path, options: argparse.Namespace, number: int, task: TaskName) -> list[Given]:
    """Return a task of a world; none, after a line on stderr, if no motion is found."""
    counts: Any = {"session": options.session_frames, "recording": options.recording_frames}
    try:
        return [given_task(folder, task, table()[number], options.seed, counts)]
    except InputError:
        raise
    except DvrkCmaesError as error:
        print(f"measure.py: {error}", file=sys.stderr)
        return []


def _tasks(options: argparse.Namespace) -> list[TaskName]:
    """Return the tasks that are asked for."""
    names: list[TaskName] = options.tasks.split(",")
    _known("--tasks", names, TASKS)
    return names


def _numbers(options: argparse.Namespace) -> list[int]:
    """Return the numbers of the worlds."""
    every = [*table()]
    if options.numbers is None:
        return every[: options.worlds]
    _known("--numbers", options.numbers.split(","), {str(number): None for number in every})
    return [int(number) for number in options.numbers.split(",")]


def _known(where: str, names: Sequence[str], known: Mapping[Any, Any]) -> None:
    """Raise an InputError for a name that is not known."""
    for name in names:
        if name not in known:
            raise InputError(f"{where}: expected some of {', '.join(known)}, got {name!r}")
