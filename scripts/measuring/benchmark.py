"""A benchmark of instrument poses on drawn worlds with known truth: tasks, methods, submissions, scores.

A folder of the benchmark has, by seed and world, ``drawn`` sessions and recordings with the truth, and what is
``given`` to methods: the same without the truth, of the task ``images`` also without masks. A submission is a file of
JSON Lines with a row for each frame of each task: ``task``, ``world`` and the fields of a result: ``frame``,
``status``, ``camera_from_root`` (of the task base the pose camera_from_base), ``joints``, optional ``covariance`` or
``std``, and ``seconds``, of processor time.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

import cv2
import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.json_file import write_json, write_text
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.results.result import POSE_AXES, Result
from measuring.report import Report, in_processes
from measuring.runner import Command, solved
from measuring.scorer import Document, Scored, figures, is_wrong, score_base, scored
from measuring.worlds import VALUES, Drawn, Kind, World, drawn_world, worlds

TaskName = Literal["frame", "session", "eyes", "base", "masks", "images"]
Key = tuple[str, int, str]

SEED: Final = 1001
"""The published seed. The program's settings were chosen on worlds of other seeds."""
BASE: Final = "base"
"""What a row of the task base has as its frame."""
TASKS: Final[Mapping[TaskName, Kind]] = {
    "frame": "session",
    "session": "session",
    "eyes": "session",
    "base": "session",
    "masks": "recording",
    "images": "recording",
}
"""The tasks, and what is given: a session, or a recording."""
METHODS: Final[Mapping[str, tuple[tuple[TaskName, ...], Command, tuple[str, ...]]]] = {
    "estimate": (("frame",), "estimate", ()),
    "calibrate": (("session", "eyes", "base"), "calibrate", ()),
    "track": (("masks", "images"), "track", ()),
    "track-causal": (("masks", "images"), "track", ("--causal",)),
    "pnp": (("frame",), "pnp", ()),
}
"""The tasks of each method, its command, and further options."""
OURS: Final = ("estimate", "calibrate", "track", "track-causal")
STATED: Final = ("status", "camera_from_root", "joints", "covariance", "std", "seconds")
"""Fields of a row besides its key."""


@dataclass(frozen=True)
class Given:
    """The folder that a method is given of a task, and the drawn one with the truth, which only the scorer reads."""

    task: TaskName
    path: Path
    drawn: Drawn

    @property
    def world(self) -> World:
        """The world."""
        return self.drawn.world


@cache
def _instrument() -> Instrument:
    """Load the instrument of all worlds."""
    return load_instrument("lnd")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("what", choices=("run", "draw", "score"), help="what to do")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of worlds and results")
    parser.add_argument("submissions", nargs="*", type=Path, metavar="FILE", help="submissions to score")
    parser.add_argument("--worlds", type=int, default=20, metavar="N", help="the first N worlds (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="seed of the worlds (default: %(default)s)")
    parser.add_argument("--tasks", nargs="+", default=[*TASKS], choices=[*TASKS], help="tasks (default: all)")
    parser.add_argument("--methods", nargs="+", default=[*OURS], choices=[*METHODS], help="methods of run")
    parser.add_argument("--session-frames", type=int, default=6, metavar="N", help="frames of sessions")
    parser.add_argument("--recording-frames", type=int, default=30, metavar="N", help="frames of recordings")
    parser.add_argument("--by-value", action="store_true", help="print rows by value of each parameter of the worlds")


def benchmark_report(options: argparse.Namespace) -> Report:
    """Do what is asked for, and return its table."""
    numbers, submissions = [*worlds()][: options.worlds], options.submissions
    if options.what == "run":
        jobs = [(options, number) for number in numbers]
        found = [pair for each in in_processes(_solved_world, jobs, options.workers, "worlds") for pair in each]
        submissions = [options.folder / f"{method}.jsonl" for method in options.methods]
        for path in submissions:
            write_text(path, "".join(f"{json.dumps(row)}\n" for name, row in found if name == path.stem))
    elif options.what == "score" and not submissions:
        raise InputError("score: expected submissions (JSON Lines) after the folder, got none")
    givens = [given for number in numbers for given in _given_tasks(options, number)]
    if options.what == "draw":
        return {"given": [{"task": o.task, "world": o.world.number, "folder": str(o.path)} for o in givens]}
    rows, values = list[dict[str, Any]](), list[dict[str, Any]]()
    for path in submissions:
        for task, scores in _scored_tasks(givens, read_submission(path), path).items():
            rows.append({"task": task, "method": path.stem, **_figures(task, [frames for _, frames in scores])})
            for name in VALUES if options.by_value else ():
                known = [(world.describe()[name], frames) for world, frames in scores]
                for value in dict.fromkeys(value for value, _ in known):
                    own = _figures(task, [frames for other, frames in known if other == value])
                    values.append({"parameter": name, "value": value, "task": task, "method": path.stem, **own})
    report = {"table": sorted(rows, key=lambda row: ([*TASKS].index(row["task"]), row["error, mm"]))}
    report |= {"by value of a parameter": values} if values else {}
    write_json(options.folder / "scores.json", {**report, "seed": options.seed, "worlds": numbers})
    return report


def _given_tasks(options: argparse.Namespace, number: int) -> Iterator[Given]:
    """Yield the tasks of a world; none, after a line on stderr, of a kind of which no motion is found."""
    world, counts = worlds()[number], {"session": options.session_frames, "recording": options.recording_frames}
    place = Path(f"seed{options.seed}") / f"{number:03d}"
    for task in options.tasks:
        kind = TASKS[task]
        try:
            parent = options.folder / "drawn" / place
            drawn = drawn_world(parent, world, options.seed, kind, counts[kind], eyes=task == "eyes")
        except InputError:
            raise
        except DvrkCmaesError as error:
            print(f"measure.py: {error}", file=sys.stderr)
            continue
        path = options.folder / "given" / place / f"{drawn.path.name}{'-images' if task == 'images' else ''}"
        if not path.exists() or path.stat().st_mtime < drawn.path.stat().st_mtime:
            shutil.rmtree(path, ignore_errors=True)
            hidden = ["golden*.json", "synth.json", "world.json", "alone"]
            hidden += ["masks", "ignore"] if task == "images" else ["images"] if task != "masks" else []
            shutil.copytree(drawn.path, path, ignore=shutil.ignore_patterns(*hidden), copy_function=shutil.copyfile)
            if task == "images":
                write_text(path / "boxes.csv", _first_box(drawn))
            path.touch()
        yield Given(task, path, drawn)


def _first_box(drawn: Drawn) -> str:
    """Return boxes.csv: the box around the mask in the first image, which says which instrument is meant."""
    first = min((drawn.path / "masks").glob("*.png"))
    mask = read_mask(first, label=1 if drawn.world.tools > 1 else None)
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    row = [first.stem, *map(str, (left, top, left + width - 1, top + height - 1))]
    return csv_text(("frame", "x0", "y0", "x1", "y1"), [row])


def _solved_world(options: argparse.Namespace, number: int) -> list[tuple[str, dict[str, Any]]]:
    """Solve a world by methods, each in its tasks; return rows with the name of the method."""
    out = options.folder / "solved" / f"seed{options.seed}" / f"{number:03d}"
    return [
        (method, {"task": given.task, "world": number, **row})
        for given in _given_tasks(options, number)
        for method in options.methods
        if given.task in METHODS[method][0]
        for row in _rows(method, given, out)
    ]


def _rows(method: str, given: Given, out: Path) -> Iterator[dict[str, Any]]:
    """Solve a task by the command of a method, which is kept for other tasks; yield a row for each frame."""
    _, command, further = METHODS[method]
    evidence = ["--evidence", given.task] if command == "track" else []
    only = [] if given.drawn.arm is None or command == "pnp" else ["--only", given.drawn.arm]
    ran = solved(given.path, command, out / f"{method}-{given.path.name}", [*evidence, *further, *only])
    for failure in ran.failures:
        print(f"world {given.world.number}, {given.task}: {failure.error} (of: {failure.run})", file=sys.stderr)
    names = [*given.drawn.golden()["frames"]]
    seconds = {"seconds": ran.processor / len(names)}
    if given.task == BASE:
        found = ran.document("session.json", given.drawn.arm)
        if found is not None:
            matrix = np.array(found["covariance"]["matrix"])[:6, :6].tolist()
            pose = {"status": found["status"], "camera_from_root": found["camera_from_base"]}
            yield {"frame": BASE, **pose, "covariance": {"axes": [*POSE_AXES], "matrix": matrix}, **seconds}
        return
    documents = ran.documents(given.drawn.arm)
    for name in names:
        known = {key: value for key, value in documents.get(name, {}).items() if key in STATED and value is not None}
        known["status"] = known.get("status", "failed").replace("lost", "failed")
        yield {"frame": name, **known, **seconds}


def read_submission(path: Path) -> dict[Key, Document]:
    """Read a submission: rows by task, world and frame.

    Raises
    ------
    InputError
        Naming the file, the line and the field, what was expected and what was there.
    """
    rows: dict[Key, Document] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        where = f"{path}: line {number}"
        try:
            fields = json.loads(line)
        except ValueError:
            raise InputError(f"{where}: expected a row as JSON, got {shown(line)}") from None
        Result.from_dict({"joints": {}, **fields, "std": None}, where=where)
        if fields.get("task") not in TASKS or not isinstance(fields.get("world"), int):
            got = shown([fields.get("task"), fields.get("world")])
            raise InputError(f"{where}: task, world: expected one of {', '.join(TASKS)}, and a number, got {got}")
        posed = fields["task"] != BASE and fields.get("camera_from_root") is not None
        asked = _instrument().joint_names if posed else ()
        if missing := [name for name in asked if name not in fields.get("joints", {})]:
            raise InputError(f"{where}: joints: expected {', '.join(asked)} in rad, got no {missing[0]}")
        key = fields["task"], fields["world"], str(fields.get("frame"))
        if key in rows:
            raise InputError(f"{where}: expected each frame once, got {shown([*key])} again")
        rows[key] = fields
    return rows


def _scored_tasks(
    givens: Sequence[Given], rows: Mapping[Key, Document], path: Path
) -> dict[TaskName, list[tuple[World, list[Scored]]]]:
    """Score a submission in the tasks that it has rows of, in all of the given worlds of these.

    Raises
    ------
    InputError
        A row is of a task, world or frame that is not given.
    """
    goldens = [given.drawn.golden() for given in givens]
    known = {
        (given.task, given.world.number, name)
        for given, golden in zip(givens, goldens, strict=True)
        for name in ([BASE] if given.task == BASE else golden["frames"])
    }
    if strangers := sorted(set(rows) - known):
        raise InputError(f"{path}: expected tasks, worlds and frames that were drawn, got {shown([*strangers[0]])}")
    tried = {task for task, _, _ in rows}
    out: dict[TaskName, list[tuple[World, list[Scored]]]] = {}
    for given, golden in zip(givens, goldens, strict=True):
        if given.task not in tried:
            continue
        place = (given.task, given.world.number)
        own = {key[2]: row for key, row in rows.items() if key[:2] == place and row.get("camera_from_root") is not None}
        if given.task == BASE:
            base = {**own[BASE], "camera_from_base": own[BASE]["camera_from_root"]} if own else None
            frames = [score_base(base, np.array(golden["camera_from_base"]))[0]]
        else:
            frames = [*scored(_instrument(), own, golden["frames"], given.world.camera.fx)]
        out.setdefault(given.task, []).append((given.world, frames))
    return out


def _figures(task: TaskName, scores: Sequence[Sequence[Scored]]) -> dict[str, Any]:
    """Return the row of the table for a method in a task, over its worlds."""
    found = figures([frame for frames in scores for frame in frames])
    alone = task in ("frame", BASE)
    return {
        "worlds": len(scores),
        **{name: found[name] for name in ("frames", "ok", "ok and wrong")},
        "recordings wrong": None if alone else sum(is_wrong(frames) for frames in scores),
        "right mode": found["right mode"],
        "error, mm": found["tips, mm"],
        "95 %, mm": found["95 %"],
        **{name: found[name] for name in ("worst ok", "shaft, deg", "joints, deg", "90 % intervals", "90 % regions")},
        "processor s a row": found["s a frame"],
    }
