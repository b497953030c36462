"""What the page says of all frames together: counts, overlap, times, and how nearly they agree about the arm's base."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.consistency import FEWEST, PointSpread, converge_shafts, spread_of_bases
from dvrk_cmaes.results.result import Result

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """A number that sums the session up: its name, its value with the unit, and what else belongs to it."""

    name: str
    value: str
    note: str


@dataclass(frozen=True)
class Run:
    """What a batch's summary says of the run: the session's name, frames without a result, and how long it took, s."""

    session: str = ""
    missing: int = 0
    seconds: float | None = None
    frames: int = 0

    @staticmethod
    def of(summary: Mapping[str, Any] | None) -> Run:
        """Take what is known from a summary.json of any version."""
        document = summary or {}
        session, missing, timing = document.get("session"), document.get("missing"), document.get("timing")
        run = timing.get("run") if isinstance(timing, Mapping) else None
        seconds, frames = (run.get("seconds"), run.get("frames")) if isinstance(run, Mapping) else (None, None)
        return Run(
            session=PurePath(session).name if isinstance(session, str) else "",
            missing=len(missing) if isinstance(missing, Sequence) and not isinstance(missing, str) else 0,
            seconds=float(seconds) if isinstance(seconds, int | float) else None,
            frames=frames if isinstance(frames, int) else 0,
        )


@dataclass(frozen=True, eq=False)
class SessionBase:
    """Where frames put the arm's base: ``frames`` (N names), ``camera_from_base`` (N, 4, 4).

    Its origin is the remote centre of motion (RCM), ``p - (q3 - 0.0156) d`` for the Classic with a tool 400xxx, where p
    is the root's origin, d the shaft's direction and q3 the insertion read, m.
    """

    frames: tuple[str, ...]
    camera_from_base: Float64

    @staticmethod
    def of(results: Sequence[Result]) -> SessionBase | None:
        """Gather the bases of all frames that have one; None where none has."""
        found = [(result.frame, result.camera_from_base) for result in results if result.camera_from_base is not None]
        if not found:
            return None
        return SessionBase(tuple(name for name, _ in found), np.stack([pose for _, pose in found]))

    @property
    def points(self) -> Float64:
        """The RCM by each frame, (N, 3) m in the camera."""
        return np.asarray(self.camera_from_base[:, :3, 3])

    @property
    def centre(self) -> Float64:
        """Median of the points, axis by axis, (3,) m: wrong frames hardly move it."""
        return np.asarray(np.median(self.points, axis=0))

    @property
    def distances(self) -> Float64:
        """Of the points from their median, (N,) m."""
        return np.asarray(np.linalg.norm(self.points - self.centre, axis=1))


@dataclass(frozen=True)
class JointSummary:
    """Correction of one joint (found less read) over the frames, deg.

    Half of the frames are within ``half_within`` of the ``median``; ``largest`` is that of ``frame``.
    """

    joint: str
    frames: int
    median: float
    half_within: float
    largest: float
    frame: str
    std: float | None


@dataclass(frozen=True)
class Origin:
    """How results came about: ``frames`` of them, by this version, instrument, seed and configuration (JSON)."""

    frames: int
    version: str
    instrument: str
    seed: int
    config: str


def session_figures(results: Sequence[Result], base: SessionBase | None, run: Run) -> Iterator[Figure]:
    """Sum up a session of at least one frame."""
    judged = [(result.quality, result.frame) for result in results if result.quality is not None]
    if judged:
        worst, where = min(((q.iou, frame) for q, frame in judged))
        yield Figure(
            "Overlap (IoU), median", f"{np.median([q.iou for q, _ in judged]):.3f}", f"lowest {worst:.3f} ({where})"
        )
        yield Figure(
            "Outline to mask, median",
            f"{np.median([q.contour_px_median for q, _ in judged]):.1f} px",
            f"95 % of it within {np.median([q.contour_px_95 for q, _ in judged]):.1f} px, "
            f"in the worst frame {max(q.contour_px_95 for q, _ in judged):.1f} px",
        )
    seconds = [result.seconds for result in results if result.status != "failed"]
    if seconds:
        note = f"slowest {max(seconds):.2f} s"
        if run.seconds is not None and run.frames:
            note += f"; {run.frames:,} frame{'' if run.frames == 1 else 's'} in {_duration(run.seconds)}"
        yield Figure("Time a frame, median", f"{np.median(seconds):.2f} s", note)
    yield from _agreement(results, base)


def _agreement(results: Sequence[Result], base: SessionBase | None) -> Iterator[Figure]:
    """How nearly the frames agree about where the arm stands, with at least three of them."""
    poses = [result.camera_from_root for result in results if result.camera_from_root is not None]
    kind = "; solved together: no check" if any(result.source == "session" for result in results) else ""
    if base is not None and len(base.frames) >= FEWEST:
        points = PointSpread(base.points)
        yield Figure(
            "RCM, spread (rms)",
            f"{1e3 * points.rms:.1f} mm",
            f"half of {len(base.frames)} frames within {1e3 * np.median(base.distances):.1f} mm of the median{kind}",
        )
        turned = spread_of_bases(base.camera_from_base)
        yield Figure(
            "Arm's base, rotation",
            f"{turned.median_deg:.1f}°",
            f"median from the most central frame, at most {turned.largest_deg:.1f}°{kind}",
        )
    if len(poses) >= FEWEST:
        try:
            meeting = converge_shafts(np.stack(poses))
        except InputError:  # The shaft hardly turned.
            return
        yield Figure(
            "Shaft axes meet, rms",
            f"{1e3 * meeting.rms:.2f} mm",
            f"standard deviation of their distances {1e3 * meeting.sigma:.2f} mm{kind}",
        )


def _duration(seconds: float) -> str:
    """Say how long something took, to about a hundredth."""
    whole = round(seconds)
    if whole < 100:
        return f"{seconds:.3g} s"
    return f"{whole // 60} min {whole % 60} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60} min"


def correction(result: Result, joint: str) -> float | None:
    """Found less read, rad, or None where the joint was not read."""
    read = result.readings.get(joint)
    return None if read is None or joint not in result.joints else result.joints[joint] - read


def joint_summaries(results: Sequence[Result]) -> Iterator[JointSummary]:
    """Sum up each joint's corrections, in the instrument's order; joints that were never read are left out."""
    for joint in dict.fromkeys(name for result in results for name in result.joints):
        read, changes = [], []
        for result in results:
            change = correction(result, joint)
            if change is not None:
                read.append(result)
                changes.append(change)
        if not read:
            continue
        off = np.degrees(changes)
        std = [result.std_joints_deg[joint] for result in read if result.std_joints_deg is not None]
        at = int(np.abs(off).argmax())
        yield JointSummary(
            joint=joint,
            frames=len(read),
            median=float(np.median(off)),
            half_within=float(np.median(np.abs(off - np.median(off)))),
            largest=float(off[at]),
            frame=read[at].frame,
            std=float(np.median(std)) if std else None,
        )


def reason_counts(results: Sequence[Result]) -> list[tuple[str, int]]:
    """Kinds of reasons (what stands before the colon) and in how many frames each is given, most frequent first."""
    kinds = (dict.fromkeys(reason.partition(":")[0] for reason in result.reasons) for result in results)
    return sorted(Counter(kind for frame in kinds for kind in frame).items(), key=lambda item: (-item[1], item[0]))


def common_warnings(results: Sequence[Result]) -> list[str]:
    """Warnings that every one of several frames carries."""
    if len(results) < 2:
        return []
    shared = set.intersection(*(set(result.warnings) for result in results))
    return [text for text in dict.fromkeys(results[0].warnings) if text in shared]


def origins(results: Sequence[Result]) -> list[Origin]:
    """How the results came about, those of most frames first."""
    counts = Counter(
        (
            result.version,
            result.instrument,
            result.seed,
            json.dumps(result.config, indent=2, sort_keys=True, ensure_ascii=False),
        )
        for result in results
    )
    return [Origin(number, *kind) for kind, number in sorted(counts.items(), key=lambda item: (-item[1], item[0]))]
