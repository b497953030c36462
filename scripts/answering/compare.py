"""Answers of two checkouts compared value by value: documents, tables and the poses in them."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import log_rotation

Float64 = NDArray[np.float64]

FOLDER: Final = "FOLDER"
"""What stands for the case's folder in texts."""

_UNREAD: Final = ("checkpoint.json", "run.json", ".written.json")  # an unfinished run; inputs and digests of files
_LEFT_OUT: Final = frozenset({"seconds", "timing", "version", "created", "calibration"})
"""Fields with times of computation, versions, dates, or the digest of a calibration that has such fields."""

_NUMBER: Final = re.compile(r"-?\d+(\.\d+)?")
_ALIKE: Final = 1e-3  # of mode probabilities
_MOST_SHOWN: Final = 5


@dataclass(frozen=True)
class Difference:
    """Two values that differ: their place, such as ``out/poses.csv: 3.loss``, and both; None where one is missing."""

    place: str
    this: Any
    other: Any

    @property
    def relative(self) -> float | None:
        """The difference of two numbers relative to the larger one; None for other values."""
        if not (_is_number(self.this) and _is_number(self.other)):
            return None
        return float(abs(self.this - self.other) / max(abs(self.this), abs(self.other)))

    def __str__(self) -> str:
        return f"{self.place}: {self.other!r} -> {self.this!r}"


@dataclass(frozen=True, eq=False)
class Answer:
    """What a document says of a pose.

    verdict : status, wording of the reasons without their numbers, relations of the other modes, frames left out.
    pose : (4, 4), m, None without one. values : joints or offsets by name. covariance : of [tx ty tz rx ry rz], m and
    rad, and of ``axes``, which name values.
    """

    verdict: Mapping[str, Any]
    mode_probability: float | None
    pose: Float64 | None
    values: Mapping[str, float]
    axes: tuple[str, ...]
    covariance: Float64 | None

    @staticmethod
    def of(document: Any) -> Answer | None:
        """Take the answer of a frame's result, a followed frame or a session's calibration; None for other documents.

        The covariance of a followed frame has the squares of its standard deviations only.
        """
        if not isinstance(document, dict) or "status" not in document:
            return None
        if "camera_from_root" not in document and "camera_from_base" not in document:
            return None
        pose = document.get("camera_from_root", document.get("camera_from_base"))
        alternatives, left_out = document.get("alternatives") or [], document.get("left_out") or {}
        verdict = {
            "status": document["status"],
            "reasons": [_NUMBER.sub("#", text) for text in document.get("reasons", [])],
            "modes": [one.get("relation") for one in alternatives],
            "left out": sorted(left_out),
        }
        values = document.get("joints" if "camera_from_root" in document else "offsets") or {}
        axes, covariance = _uncertainty(document)
        where = None if pose is None else np.array(pose, dtype=np.float64)
        return Answer(verdict, document.get("mode_probability"), where, values, axes, covariance)

    def changes(self, other: Answer) -> list[str]:
        """List what differs in the verdict, from the other's to this one's."""
        found = [
            f"{name} {other.verdict[name]!r} -> {value!r}"
            for name, value in self.verdict.items()
            if value != other.verdict[name]
        ]
        mine, theirs = self.mode_probability, other.mode_probability
        if (mine is None) != (theirs is None) or abs((mine or 0.0) - (theirs or 0.0)) > _ALIKE:
            found.append(f"mode probability {theirs} -> {mine}")
        if (self.pose is None) != (other.pose is None):
            found.append("pose appeared" if other.pose is None else "pose is gone")
        return found

    def change(self, other: Answer) -> float | None:
        """Compute the change of pose and values in the other's standard deviations; None without poses.

        It is the root mean square of L^-1 d, where d are the differences in the axes of the pose's source frame, and
        L L^T is the other's covariance; its diagonal alone where it is singular.
        """
        if self.pose is None or other.pose is None or other.covariance is None:
            return None
        if not set(other.axes) <= set(self.values):
            return np.inf
        turned = other.pose[:3, :3].T
        moved = turned @ (self.pose[:3, 3] - other.pose[:3, 3])
        joints = [self.values[name] - other.values[name] for name in other.axes]
        step = np.concatenate([moved, log_rotation(turned @ self.pose[:3, :3]), joints])
        return float(np.sqrt(np.mean(_in_deviations(step, other.covariance) ** 2)))


def read_answers(folder: Path) -> dict[str, Any]:
    """Read all JSON, JSON lines and CSV files below a folder, by their path in it.

    A table is a list of rows by column, whose cells are numbers where they can be. The folder's own path in texts is
    ``FOLDER``.
    """
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix not in (".json", ".jsonl", ".csv") or path.name in _UNREAD:
            continue
        text = path.read_text(encoding="utf-8").replace(str(folder), FOLDER)
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json":
            found[name] = json.loads(text)
        elif path.suffix == ".jsonl":
            found[name] = [json.loads(line) for line in text.splitlines()]
        else:
            rows = csv.DictReader(text.splitlines())
            found[name] = [{column: _cell(cell) for column, cell in row.items()} for row in rows]
    return found


def differences(this: Any, other: Any, place: str) -> Iterator[Difference | None]:
    """Compare two documents; yields None for each pair of equal values, and the difference for the others.

    Times of computation, versions and dates are left out.
    """
    if isinstance(this, dict) and isinstance(other, dict):
        for name in [*this, *(name for name in other if name not in this)]:
            if not _is_left_out(name, this if name in this else other):
                yield from differences(this.get(name), other.get(name), f"{place}.{name}")
    elif isinstance(this, list) and isinstance(other, list):
        if len(this) != len(other):
            yield Difference(f"{place}, length", len(this), len(other))
        for number, (mine, theirs) in enumerate(zip(this, other, strict=False)):
            yield from differences(mine, theirs, f"{place}.{number}")
    else:
        yield None if _is_same(this, other) else Difference(place, this, other)


def compare(this: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Compare the answers of two checkouts to one case, as `read_answers` gives them.

    Returns the numbers of files, values and values that differ, the largest relative difference of two numbers, files
    of one checkout only, changed verdicts, the largest change of a pose in standard deviations, and first differences.
    """
    names = sorted(set(this) & set(other))
    missing = [f"{name}: not in the other checkout" for name in sorted(set(this) - set(other))]
    missing += [f"{name}: missing in this checkout" for name in sorted(set(other) - set(this))]
    compared = [one for name in names for one in differences(this[name], other[name], f"{name}: ")]
    found = [one for one in compared if one is not None]
    verdicts, changes = _poses(this, other, names)
    return {
        "files": len(names),
        "values": len(compared),
        "differ": len(found) + len(missing),
        "largest relative": max((one.relative for one in found if one.relative is not None), default=0.0),
        "largest change": max(changes, default=0.0),
        "missing": missing,
        "verdicts": verdicts,
        "first": [str(one).replace(": .", ": ") for one in found[:_MOST_SHOWN]],
    }


def accepted(row: Mapping[str, Any], largest_change: float | None) -> bool:
    """Return whether a case's answers are equal or, with a limit, changed by less than so many standard deviations."""
    if not row["differ"]:
        return True
    if largest_change is None or row["missing"] or row["verdicts"]:
        return False
    return bool(row["largest change"] < largest_change)


def _poses(this: Mapping[str, Any], other: Mapping[str, Any], names: Sequence[str]) -> tuple[list[str], list[float]]:
    """Compare all poses of documents; returns changed verdicts, and changes in standard deviations."""
    verdicts: list[str] = []
    changes: list[float] = []
    for name in names:
        mine, theirs = (_answers(each[name]) for each in (this, other))
        if len(mine) != len(theirs):
            verdicts.append(f"{name}: {len(theirs)} poses -> {len(mine)}")
        for number, (one, before) in enumerate(zip(mine, theirs, strict=False)):
            if one is None or before is None:
                continue
            place = name if len(mine) == 1 else f"{name}, {number}"
            verdicts += [f"{place}: {text}" for text in one.changes(before)]
            change = one.change(before)
            changes += [] if change is None else [change]
    return verdicts, changes


def _answers(document: Any) -> list[Answer | None]:
    """Return the answers of a document, or of the documents in its lines."""
    return [Answer.of(one) for one in (document if isinstance(document, list) else [document])]


def _uncertainty(document: Mapping[str, Any]) -> tuple[tuple[str, ...], Float64 | None]:
    """Return the names of the values of a document's covariance beyond its pose, and the covariance."""
    covariance, std = document.get("covariance"), document.get("std")
    if covariance:
        return tuple(covariance["axes"][6:]), np.array(covariance["matrix"])
    if not std or "translation_mm" not in std:
        return (), None
    joints = std["joints_deg"]
    angles = np.radians([*std["rotation_deg"], *joints.values()])
    return tuple(joints), np.diag(np.concatenate([np.array(std["translation_mm"]) * 1e-3, angles])) ** 2


def _in_deviations(step: Float64, covariance: Float64) -> Float64:
    """Return a step (N,) in standard deviations of a covariance (N, N)."""
    scale = np.sqrt(np.diag(covariance))
    relative = step / scale
    try:
        root = np.linalg.cholesky(covariance / np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.asarray(relative)
    return np.asarray(np.linalg.solve(root, relative))


def _is_left_out(name: str, document: Mapping[str, Any]) -> bool:
    """Return whether a field is not compared; the seconds of a lag are."""
    return name in _LEFT_OUT and "std_seconds" not in document


def _is_same(this: Any, other: Any) -> bool:
    """Return whether two values are equal; 1 and 1.0 are, true and 1 are not."""
    alike = type(this) is type(other) or (_is_number(this) and _is_number(other))
    return bool(alike and (this == other or (this != this and other != other)))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _cell(text: str | None) -> Any:
    """Return a cell as a number, or as text."""
    try:
        return float(text or "")
    except ValueError:
        return text
