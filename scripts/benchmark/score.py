"""Scores of submissions against the truth: errors modulo nothing, coverage of stated intervals, what is ok and wrong.

The mirror twin is an error, and so are exchanged jaws. A frame without a row, or without a pose, is a metre off. Frames
in which less than half of the ends is seen do not count. A frame is ok and wrong if its status is ok and the ends of
the instrument are off by more than 3 mm and 2 px in the mean; the stated standard deviation does not excuse it. A
recording or session is wrong if more than a fifth of its ok frames are off by more than 3 mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from measure.accuracy.worlds import WITHOUT_POSE_MM, WRONG_MM, Command, Scored, Solved, figures, scored
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from benchmark.submission import JOINTS, Key, Row, rows_of
from benchmark.tasks import BASE, Given, TaskName
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.pose_error import compare_rotations
from dvrk_cmaes.geometry import change_between

Float64 = NDArray[np.float64]

LEVELS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
"""Probabilities of the intervals whose coverage is counted."""
SHOWN: Final = 0.9
WRONG_BASE_DEG: Final = 2.0
"""A base whose status is ok is wrong if it is turned by more than this, or moved by more than 3 mm."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of a task in a world: frames, the errors of poses, and errors in standard deviations.

    ``root_mm``, ``shaft_deg`` and ``joints_deg`` (the mean of the absolute values) are of frames with a pose.
    ``ratios`` (N, 6 + J) are the errors of the ok frames that state standard deviations, in these, ``squares`` the
    squared errors in their covariances with the number of degrees of freedom. ``seconds`` are of each row.
    """

    given: Given
    frames: tuple[Scored, ...]
    root_mm: tuple[float, ...]
    shaft_deg: tuple[float, ...]
    joints_deg: tuple[float, ...]
    ratios: tuple[Float64, ...]
    squares: tuple[tuple[float, int], ...]
    seconds: tuple[float, ...]


def score_world(given: Given, rows: Mapping[str, Row]) -> Scores:
    """Score the rows of a task in a world, by frame.

    Raises
    ------
    InputError
        A row's frame is not one of the task.
    """
    strangers = sorted(set(rows) - set(given.frames))
    if strangers:
        place = f"task {given.task}, world {given.world.number}"
        raise InputError(f"{place}: frame: expected one of {given.frames[0]} to {given.frames[-1]}, got {strangers[0]}")
    truths = _truths(given)
    frames = tuple(_of_base(given, rows) if given.task == BASE else scored(given.drawn, _results(rows)))
    root, shaft, joints, ratios, squares = [], [], [], [], []
    for frame in frames:
        row = rows.get(frame.frame)
        if row is None or row.pose is None:
            continue
        pose, values = truths[frame.frame]
        root.append(1e3 * float(np.linalg.norm(row.pose[:3, 3] - pose[:3, 3])))
        shaft.append(compare_rotations(row.pose, pose).shaft_deg)
        error = change_between(row.pose, pose)
        if row.joints is not None:
            error = np.append(error, values - row.joints)
            joints.append(float(np.degrees(np.abs(values - row.joints).mean())))
        std = row.stated_std
        if row.status == "ok" and std is not None:
            ratios.append(error / std)
        if row.status == "ok" and row.covariance is not None:
            squares.append((float(error @ np.linalg.solve(row.covariance, error)), len(error)))
    seconds = tuple(row.seconds for row in rows.values() if row.seconds is not None)
    return Scores(given, frames, tuple(root), tuple(shaft), tuple(joints), tuple(ratios), tuple(squares), seconds)


def _truths(given: Given) -> dict[str, tuple[Float64, Float64]]:
    """Return the true pose (4, 4) and joints (J,) by frame."""
    if given.task == BASE:
        return {BASE: (given.drawn.camera_from_base(), np.empty(0))}
    return {
        name: (np.array(truth["T_camera_roll_link"]), np.array([truth["joints"][joint] for joint in JOINTS]))
        for name, truth in given.drawn.golden().items()
    }


def _results(rows: Mapping[str, Row]) -> dict[str, Any]:
    """Return rows as results, without standard deviations of the ends: these excuse no error."""
    return {
        name: {
            "status": row.status,
            "camera_from_root": None if row.pose is None else row.pose.tolist(),
            "joints": {} if row.joints is None else dict(zip(JOINTS, row.joints.tolist(), strict=True)),
            "std": {"tip_mm": 0.0},
        }
        for name, row in rows.items()
    }


def _of_base(given: Given, rows: Mapping[str, Row]) -> Iterable[Scored]:
    """Compare the base with the truth: its error is that of its origin, the remote centre of motion."""
    row, (true, _) = rows.get(BASE), _truths(given)[BASE]
    if row is None or row.pose is None:
        yield Scored(BASE, "failed" if row is None else row.status, WITHOUT_POSE_MM, 0.0, 180.0, WRONG_MM)
        return
    turned = compare_rotations(row.pose, true).rotation_deg
    moved = 1e3 * float(np.linalg.norm(row.pose[:3, 3] - true[:3, 3]))
    yield Scored(BASE, row.status, moved, 0.0, turned, WRONG_MM if turned <= WRONG_BASE_DEG else -1.0)


def score_row(method: str, task: TaskName, scores: Sequence[Scores]) -> dict[str, Any]:
    """Return the row of the table for a method in a task, over its worlds."""
    command: Command = "estimate" if task in ("frame", BASE) else "track"
    found = [Solved(each.given.world, command, each.frames, (), 0.0) for each in scores]
    common = figures(found)
    errors = [frame.error_mm for each in scores for frame in each.frames]
    ratios = [ratio for each in scores for ratio in each.ratios]
    squares = [square <= chi2.ppf(SHOWN, count) for each in scores for square, count in each.squares]

    def median(name: str) -> float | None:
        values = [value for each in scores for value in getattr(each, name)]
        return float(np.median(values)) if values else None

    seconds = [value for each in scores for value in each.seconds]
    return {
        "task": task,
        "method": method,
        "worlds": len(scores),
        "frames": len(errors),
        "ok": common["ok"],
        "ok and wrong": common["ok and wrong"],
        "recordings wrong": common["recordings wrong"] if command == "track" else None,
        "right mode": common["right mode"],
        "error, mm": common["ends, mm"],
        "95 %, mm": float(np.quantile(errors, 0.95)) if errors else None,
        "worst ok, mm": common["worst ok, mm"],
        "root, mm": median("root_mm"),
        "shaft, deg": median("shaft_deg"),
        "joints, deg": median("joints_deg"),
        "90 % intervals": coverage(ratios, SHOWN),
        "90 % regions": float(np.mean(squares)) if squares else None,
        "processor s a row": float(np.mean(seconds)) if seconds else None,
    }


def coverage(ratios: Sequence[Float64], level: float) -> float | None:
    """Return the share of intervals of a probability that contain the truth; None without any."""
    if not ratios:
        return None
    return float(np.mean(np.abs(np.concatenate(ratios)) <= norm.ppf((1 + level) / 2)))


def reliability(scores: Sequence[Scores]) -> list[float] | None:
    """Return the coverage of the intervals of each of ``LEVELS``; None if nothing states any."""
    ratios = [ratio for each in scores for ratio in each.ratios]
    return [coverage(ratios, level) or 0.0 for level in LEVELS] if ratios else None


def ranked(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows of the table by task and rank, that of the median error; equal errors have the same rank."""
    out: list[dict[str, Any]] = []
    for task in dict.fromkeys(row["task"] for row in rows):
        own = sorted((row for row in rows if row["task"] == task), key=lambda row: float(row["error, mm"]))
        for row in own:
            rank = 1 + sum(other["error, mm"] < row["error, mm"] for other in own)
            out.append({"task": task, "rank": rank, **row})
    return out


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
            out.setdefault(given.task, []).append(score_world(given, rows_of(rows, given.task, given.world.number)))
    return out
