"""The page's summary of a session: overlap, times, agreement of the frames, corrections, reasons and warnings."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.consistency import LEAST_FRAMES, PointSpread, converge_shafts, spread_of_bases
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.results.result import Result

_PLACE = re.compile(r"^(?:[^:]*(?:/|\.\w{2,5})[^:]*(?::\d+)?: )?(?:frame [^:]*: )?")
"""The path, line and frame at the beginning of a reason."""


@dataclass(frozen=True)
class KeyFigure:
    """A key figure of a session: its name, its value with the unit, and a note."""

    name: str
    value: str
    note: str


@dataclass(frozen=True)
class Run:
    """Data of a run from a batch's summary.json.

    session : name of the session. missing : number of frames without a result. seconds : duration, None if unknown.
    frames : number of frames solved in that time.
    """

    session: str = ""
    missing: int = 0
    seconds: float | None = None
    frames: int = 0

    @staticmethod
    def of(summary: Mapping[str, Any] | None) -> Run:
        """Read the known fields of a summary.json of any version; others have their defaults."""
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
class FrameBases:
    """Pose of the arm's base in each of N frames: ``frames``, their names, and ``camera_from_base`` (N, 4, 4).

    The base's origin is the remote centre of motion (RCM), ``p - (q3 - 0.0156) d`` for the Classic with a tool 400xxx,
    where p is the root's origin, d the shaft's direction and q3 the insertion reading, m.
    """

    frames: tuple[str, ...]
    camera_from_base: Float64

    @staticmethod
    def of(results: Sequence[Result]) -> FrameBases | None:
        """Collect the poses of the base from all results that have one; None if there are none."""
        found = [(result.frame, result.camera_from_base) for result in results if result.camera_from_base is not None]
        if not found:
            return None
        return FrameBases(tuple(name for name, _ in found), np.stack([pose for _, pose in found]))

    @property
    def points(self) -> Float64:
        """RCM of each frame, (N, 3) m in the camera."""
        return np.asarray(self.camera_from_base[:, :3, 3])

    @property
    def centre(self) -> Float64:
        """Median of the points by coordinate, (3,) m."""
        return np.asarray(np.median(self.points, axis=0))

    @property
    def distances(self) -> Float64:
        """Distances of the points from their median, (N,) m."""
        return np.asarray(np.linalg.norm(self.points - self.centre, axis=1))


@dataclass(frozen=True)
class JointSummary:
    """Corrections of one joint (found less read), deg, over the frames in which it was read.

    frames : number of these frames. median : median correction. half_within : median absolute deviation from it.
    largest, frame : correction of the largest magnitude, and its frame.
    std : median of the estimates' standard deviations, None if they have none.
    """

    joint: str
    frames: int
    median: float
    half_within: float
    largest: float
    frame: str
    std: float | None


@dataclass(frozen=True)
class Provenance:
    """Version, instrument, seed and configuration (JSON) that ``frames`` results were computed with."""

    frames: int
    version: str
    instrument: str
    seed: int
    config: str


def session_figures(results: Sequence[Result], base: FrameBases | None, run: Run) -> Iterator[KeyFigure]:
    """Yield the key figures of a session of at least one frame."""
    judged = [(result.quality, result.frame) for result in results if result.quality is not None]
    if judged:
        worst, where = min(((q.iou, frame) for q, frame in judged))
        yield KeyFigure(
            "Overlap (IoU), median", f"{np.median([q.iou for q, _ in judged]):.3f}", f"lowest {worst:.3f} ({where})"
        )
        yield KeyFigure(
            "Outline to mask, median",
            f"{np.median([q.contour_px_median for q, _ in judged]):.1f} px",
            f"95 % of it within {np.median([q.contour_px_95 for q, _ in judged]):.1f} px, "
            f"in the worst frame {max(q.contour_px_95 for q, _ in judged):.1f} px",
        )
    tips = [(result.expected_error.tip_90_mm, result.frame) for result in results if result.expected_error is not None]
    if tips:
        most, where = max(tips)
        figure = f"{np.median([tip for tip, _ in tips]):.2f} mm"
        yield KeyFigure("Tips within (90 %), median", figure, f"at worst {most:.1f} mm ({where})")
    seconds = [result.seconds for result in results if result.seconds and result.status != "failed"]
    if seconds:
        note = f"slowest {max(seconds):.2f} s"
        if run.seconds is not None and run.frames:
            note += f"; {run.frames:,} frame{'' if run.frames == 1 else 's'} in {_duration(run.seconds)}"
        yield KeyFigure("Time a frame, median", f"{np.median(seconds):.2f} s", note)
    yield from _agreement(results, base)


def _agreement(results: Sequence[Result], base: FrameBases | None) -> Iterator[KeyFigure]:
    """Yield key figures of the agreement of at least three frames about the arm's base and the shafts' axes.

    None where frames were solved together: these agree by construction.
    """
    if any(result.source == "session" for result in results):
        return
    poses = [result.camera_from_root for result in results if result.camera_from_root is not None]
    if base is not None and len(base.frames) >= LEAST_FRAMES:
        points = PointSpread(base.points)
        yield KeyFigure(
            "RCM, spread (rms)",
            f"{1e3 * points.rms:.1f} mm",
            f"half of {len(base.frames)} frames within {1e3 * np.median(base.distances):.1f} mm of the median",
        )
        turned = spread_of_bases(base.camera_from_base)
        yield KeyFigure(
            "Arm's base, rotation",
            f"{turned.median_deg:.1f}°",
            f"median from the most central frame, at most {turned.largest_deg:.1f}°",
        )
    if len(poses) >= LEAST_FRAMES:
        try:
            meeting = converge_shafts(np.stack(poses))
        except InputError:  # the axes are parallel
            return
        yield KeyFigure(
            "Shaft axes meet, rms",
            f"{1e3 * meeting.rms:.2f} mm",
            f"standard deviation of their distances {1e3 * meeting.sigma:.2f} mm",
        )


def _duration(seconds: float) -> str:
    """Format a duration with about three significant digits."""
    whole = round(seconds)
    if whole < 100:
        return f"{seconds:.3g} s"
    return f"{whole // 60} min {whole % 60} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60} min"


def correction(result: Result, joint: str) -> float | None:
    """Return a joint's found less read, rad, or None if it was not read or not found."""
    read = result.readings.get(joint)
    return None if read is None or joint not in result.joints else result.joints[joint] - read


def joint_summaries(results: Sequence[Result]) -> Iterator[JointSummary]:
    """Yield a summary of each joint's corrections, in the instrument's order, without joints that were never read."""
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
        median, half = float(np.median(off)), float(np.median(np.abs(off - np.median(off))))
        usual = float(np.median(std)) if std else None
        yield JointSummary(joint, len(read), median, half, float(off[at]), read[at].frame, usual)


def reason_kind(reason: str) -> str:
    """Return the part of a reason that frames with the same reason share.

    Without the path and the frame's name before it, it is the text before the first colon or semicolon, or, if that is
    one word, such as the name of a field, the text before the first number or value.
    """
    plain = _PLACE.sub("", reason)
    kind = re.split(r"[:;] ", plain, maxsplit=1)[0]
    return kind if " " in kind or plain == reason else re.split(r",? got |[,;(]| [-+\d]", plain, maxsplit=1)[0]


def counted_reasons(reasons: Iterable[Sequence[str]]) -> list[tuple[str, int]]:
    """Return the kinds of the reasons of frames and their numbers of frames, most frequent first."""
    return [(kind, len(frames)) for kind, frames in frames_by_reason(reasons)]


def frames_by_reason(reasons: Iterable[Sequence[str]]) -> list[tuple[str, list[int]]]:
    """Return the kinds of the reasons of frames, most frequent first, and the places of the frames that have each."""
    kinds: dict[str, list[int]] = {}
    for place, of_frame in enumerate(reasons):
        for kind in dict.fromkeys(map(reason_kind, of_frame)):
            kinds.setdefault(kind, []).append(place)
    return sorted(kinds.items(), key=lambda item: (-len(item[1]), item[0]))


def common_warnings(results: Sequence[Result]) -> list[str]:
    """Return the remarks and warnings that all of at least two frames have."""
    if len(results) < 2:
        return []
    of_frames = [(*result.remarks, *result.warnings) for result in results]
    shared = set.intersection(*(set(texts) for texts in of_frames))
    return [text for text in dict.fromkeys(of_frames[0]) if text in shared]


def provenances(results: Sequence[Result]) -> list[Provenance]:
    """Group the results by version, instrument, seed and configuration; the largest group first."""
    configs = [json.dumps(result.config, indent=2, sort_keys=True, ensure_ascii=False) for result in results]
    counts = Counter((r.version, r.instrument, r.seed, config) for r, config in zip(results, configs, strict=True))
    return [Provenance(number, *kind) for kind, number in sorted(counts.items(), key=lambda item: (-item[1], item[0]))]
