"""The page of a session's results, OUT/report.html, and what it says of the session's calibration.

A leave-one-out prediction is the silhouette of a frame computed from the other frames and its readings, without its
image; its overlap with the frame's mask measures accuracy without true poses. The overlap of frames that were solved
together does not, since each frame's own mask was used to solve it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.io.csv_file import Table, fixed
from dvrk_cmaes.io.short_text import counted
from dvrk_cmaes.report.curves import Chart, Curve
from dvrk_cmaes.report.tables import calibration_lines, calibration_tables, result_lines, result_tables
from dvrk_cmaes.report.template import Entry, KeyFigure, Page, Part, Pictures, counted_reasons, write
from dvrk_cmaes.results.folder import (
    ALONE,
    SESSION,
    ResultsFolder,
    left_out_path,
    overlay_path,
    read_results,
    result_paths,
)
from dvrk_cmaes.results.result import Result

_STATUSES: Final = ("failed", "doubtful", "ok")
_MOST_DETAILS: Final = 300  # frames whose tables are on the page; each has a document next to the page


def write_page(out: Path, folder: ResultsFolder | None = None) -> Path:
    """Write OUT/report.html for the results in OUT, and return its path.

    The inputs are ``OUT/frames/*.json``, ``OUT/overlays/*.jpg``, and if they exist ``summary.json``, ``session.json``
    and ``overlays_left_out/*.jpg``.

    Parameters
    ----------
    out
        The folder OUT.
    folder
        The results in OUT, if they were read before; by default they are read.

    Raises
    ------
    InputError
        No results, or one that cannot be read, as in ``read_results``; a folder that cannot be written to.
    """
    return write(out / "report.html", session_page(read_results(out) if folder is None else folder))


def session_page(folder: ResultsFolder) -> Page:
    """Return the page of a results folder."""
    results = list(folder.frames.values())
    calibration = None
    if folder.session is not None:
        calibration = SessionCalibration.from_dict(folder.session, where=str(folder.folder / SESSION))
    left = {} if calibration is None else calibration.left_out
    solved = [result for result in results if result.frame not in left]  # the session's figures are of these
    summary = folder.summary or {}
    missing, session = summary.get("missing"), summary.get("session")
    notes = []
    if isinstance(missing, list) and missing:
        notes.append(f"{len(missing)} more frame{' has' if len(missing) == 1 else 's have'} no result yet.")
    pictures = Pictures(folder.folder)
    documents = {path.stem: path.relative_to(folder.folder).as_posix() for path in result_paths(folder.folder)}
    entries = _entries(folder, calibration, documents, pictures)
    first, *parts = [None] if calibration is None else _calibration_parts(folder, calibration)
    alerts = dict.fromkeys([*summary.get("warnings", ()), *(() if calibration is None else calibration.warnings)])
    name = f"{PurePath(session).name} · " if isinstance(session, str) else ""
    instruments = ", ".join(sorted({result.instrument for result in results} - {""}))
    return Page(
        "Instrument poses" if calibration is None else "Calibration of an arm and its camera",
        f"{name}{counted(len(results), 'frame')}{f' of {instruments}' if instruments else ''}"
        + (f" · dvrk-cmaes {results[0].version}" if results[0].version else ""),
        {status: sum(result.status == status for result in results) for status in reversed(_STATUSES)},
        alerts=list(alerts),
        notes=[*notes, *(f"In every frame: {text}" for text in common_warnings(results) if text not in alerts)],
        figures=list(session_figures(solved, summary)),
        reasons=counted_reasons(result.reasons for result in results),
        first=first,
        parts=[*parts, Part("Curves", charts=session_charts(results))],
        entries=entries,
        legend="Yellow: the mask. Blue: the outline of the pose. A click opens all of the overlay, with its legend.",
    )


def doubt_key(result: Result) -> tuple[int, float, float]:
    """Return a sort key that puts the most doubtful first: by status, probability of the tips, then overlap."""
    overlap = -1.0 if result.quality is None else result.quality.iou
    near = -1.0 if result.tip_probability is None else result.tip_probability
    return _STATUSES.index(result.status), near, overlap


def common_warnings(results: Sequence[Result]) -> list[str]:
    """Return the remarks and warnings that all of at least two frames have."""
    if len(results) < 2:
        return []
    of_frames = [(*result.remarks, *result.warnings) for result in results]
    shared = set.intersection(*(set(texts) for texts in of_frames))
    return [text for text in dict.fromkeys(of_frames[0]) if text in shared]


def session_figures(results: Sequence[Result], summary: Mapping[str, Any]) -> Iterator[KeyFigure]:
    """Yield the key figures of the results of a session, whose summary.json is given."""
    judged = [(result.quality, result.frame) for result in results if result.quality is not None]
    if judged:
        worst, where = min((q.iou, frame) for q, frame in judged)
        median = f"{np.median([q.iou for q, _ in judged]):.3f}"
        yield KeyFigure("Overlap (IoU), median", median, f"lowest {worst:.3f} ({where})")
        yield KeyFigure(
            "Outline to mask, median",
            f"{np.median([q.contour_px_median for q, _ in judged]):.1f} px",
            f"95 % of it within {np.median([q.contour_px_95 for q, _ in judged]):.1f} px, "
            f"in the worst frame {max(q.contour_px_95 for q, _ in judged):.1f} px",
        )
    errors = {result.frame: result.expected_error for result in results if result.expected_error is not None}
    tips = {frame: error.tip_90_mm for frame, error in errors.items() if error.determined}
    if tips:
        widest = max(tips, key=tips.__getitem__)
        note = f"at worst {tips[widest]:.1f} mm ({widest})"
        note += f"; not determined in {counted(len(errors) - len(tips), 'frame')}" if len(tips) < len(errors) else ""
        yield KeyFigure("Tips within (90 %), median", f"{np.median([*tips.values()]):.1f} mm", note)
    seconds = [result.seconds for result in results if result.seconds and result.status != "failed"]
    if seconds:
        run = (summary.get("timing") or {}).get("run") or {}
        took = f"; the run took {run['seconds']:.0f} s" if run.get("frames") else ""
        yield KeyFigure("Time a frame, median", f"{np.median(seconds):.2f} s", f"slowest {max(seconds):.2f} s{took}")


def session_charts(results: Sequence[Result]) -> list[Chart]:
    """Chart how far joints are from their readings, and the tips, over time or the frames' names."""
    times = [result.time for result in results if result.time is not None]
    timed = len(times) == len(results) > 1 and max(times) > min(times)
    places = np.array(times) - min(times) if timed else np.arange(len(results), dtype=np.float64)
    across = "time from the first image, s" if timed else "frame"
    frames = [result.frame for result in results]

    def chart(title: str, up: str, curves: Mapping[str, Sequence[float]], note: str) -> Chart:
        drawn = [Curve(name, places, np.array(y, np.float64), points=True, frames=frames) for name, y in curves.items()]
        return Chart(title, across, up, drawn, note, names=() if timed else frames, least=1.0)

    joints = dict.fromkeys(name for result in results for name in result.joints)
    apart = {
        name: [math.degrees(one.joints.get(name, math.nan) - one.readings.get(name, math.nan)) for one in results]
        for name in joints
    }
    tips = np.array([np.mean(result.tips, axis=0) if result.tips else [np.nan] * 3 for result in results]) * 1e3
    charts = [chart("Joints, found less read", "found - read, deg", apart, "")]
    if np.isfinite(tips).all(axis=1).sum() > 1:
        off = tips - np.nanmedian(tips, axis=0)
        note = "Mean of the tips, mm from its median: x right, y down, z forward."
        curves = {axis: off[:, k].tolist() for k, axis in enumerate("xyz")}
        charts.append(chart("Tips in the camera", "mm from the median", curves, note))
    return charts


# frames


def _entries(
    folder: ResultsFolder, calibration: SessionCalibration | None, documents: Mapping[str, str], pictures: Pictures
) -> list[Entry]:
    """Return the frames' entries, the most doubtful first; only those that have a file of their name have pictures."""
    ranked = sorted(folder.frames.values(), key=doubt_key)  # stable: by name where the doubts are equal
    entries = []
    for place, result in enumerate(ranked):
        shown = pictures.of(overlay_path(folder.folder, result.frame)) if result.frame in documents else []
        if calibration is not None and shown:
            predicted = left_out_path(folder.folder, result.frame)
            shown += pictures.of(predicted, "as the session's other frames predict it")
        entries.append(
            Entry(
                result.frame,
                result.status,
                shown,
                list(_lines(result, calibration)),
                result.reasons,
                [*result.warnings, *(f"not used: {text}" for text in result.unused)],
                list(result_tables(result)) if place < _MOST_DETAILS else (),
                documents.get(result.frame, ""),
            )
        )
    return entries


def _lines(result: Result, calibration: SessionCalibration | None) -> Iterator[str]:
    """Yield what an entry says of a frame."""
    yield from result_lines(result)
    if calibration is not None:
        if result.frame in calibration.left_out:
            yield f"left out of the calibration: {calibration.left_out[result.frame]}"
        if result.frame in calibration.leave_one_out:
            one = calibration.leave_one_out[result.frame]
            yield f"predicted by the others: IoU {one.iou:.3f}, outline {one.contour_px:.1f} px"


# the calibration


def _calibration_parts(folder: ResultsFolder, found: SessionCalibration) -> Iterator[Part]:
    """Yield what the page says of a calibration: base and offsets, and each frame as the others predict it."""
    note = (
        f"One place of the arm's base and one offset a joint, from {len(found.frames)} frames solved together: how "
        "well these agree says nothing about how accurate they are."
    )
    if (folder.folder / ALONE / "report.html").is_file():
        note += f" The same frames, each solved by itself: {ALONE}/report.html."
    reasons = [result.reasons for result in folder.frames.values() if result.status != "ok"]
    if found.status == "ok" and found.leave_one_out and 2 * len(reasons) > len(folder.frames):
        kind, number = counted_reasons(reasons)[0]
        note += (
            f" It is ok, since the session predicts frames that it has not seen (mean IoU {found.predicted_iou:.3f}); "
            f"{len(reasons)} of {len(folder.frames)} frames are not known well enough, {number} of them for: {kind}."
        )
    yield calibration_part(found, note)
    predicted = {name: one for name, one in found.leave_one_out.items() if name in folder.frames}
    predictions = sorted((one.iou, name, one.contour_px) for name, one in predicted.items())
    if not predictions:
        return
    table = []
    for iou, name, px in predictions:
        result = folder.frames[name]
        together = None if result.quality is None else result.quality.iou
        table.append((name, f"{iou:.3f}", f"{px:.1f}", fixed(together, 3), result.status))
    yield Part(
        "Leave one out: each frame as the others predict it, the worst first",
        notes=[
            "Its image has no part in its prediction, only its readings have: a check that needs no truth. In the "
            "pictures with the frames the mask is yellow, the prediction blue."
        ],
        tables=[Table(("frame", "IoU", "outline, median px", "IoU solved together", "status"), table, frames=True)],
    )


def calibration_part(found: SessionCalibration, *notes: str) -> Part:
    """Return what a page says of base, offsets and lag, after some notes."""
    lines, tables = [*notes, *calibration_lines(found)], list(calibration_tables(found))
    return Part(f"Calibration: {found.status}", lines, tables, [_lag_chart(found)])


def _lag_chart(found: SessionCalibration) -> Chart | None:
    """Chart the disagreement of the frames over the lag; None if no lag was searched."""
    if (curve := found.lag_curve) is None or len(curve.lags) < 2:
        return None
    note = "Mean squared disagreement of the frames with one base, in expected errors, were the images this late."
    drawn = Curve("", curve.lags, curve.misfit)
    return Chart("How late the images are", f"lag, {curve.unit}", "disagreement", [drawn], note)
