"""The page of a session's results, OUT/report.html, and what it says of the session's calibration.

A leave-one-out prediction is the silhouette of a frame computed from the other frames and its readings, without its
image; its overlap with the frame's mask measures accuracy without true poses. The overlap of frames that were solved
together does not, since each frame's own mask was used to solve it.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.geometry import Float64, in_parent, log_rotation, rotation_angle
from dvrk_cmaes.io.table import Table, fixed
from dvrk_cmaes.report.curves import Chart, Curve
from dvrk_cmaes.report.template import (
    Entry,
    KeyFigure,
    Page,
    Part,
    Picture,
    Pictures,
    counted_reasons,
    write,
)
from dvrk_cmaes.results.folder import ALONE, SESSION, ResultsFolder, read_results, result_paths
from dvrk_cmaes.results.paths import left_out_path, overlay_path
from dvrk_cmaes.results.result import Result

_STATUSES: Final = ("failed", "doubtful", "ok")
_BARS_FOR_AT_MOST: Final = 80  # frames, of which standard deviations are drawn
_MOST_PREDICTIONS: Final = 12  # pictures of predictions in the part on the calibration; all are with their frames
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
    together = sum(result.source == "session" for result in results)
    summary = folder.summary or {}
    missing, session = summary.get("missing"), summary.get("session")
    notes = []
    if isinstance(missing, list) and missing:
        notes.append(f"{len(missing)} more frame{' has' if len(missing) == 1 else 's have'} no result yet.")
    if together:
        all_of = "All" if together == len(results) else str(together)
        notes.append(
            f"{all_of} frames were solved together with their session: how well they agree says nothing about how "
            "accurate they are."
        )
    pictures = Pictures(folder.folder)
    documents = {path.stem: path.relative_to(folder.folder).as_posix() for path in result_paths(folder.folder)}
    entries = _entries(folder, calibration, documents, pictures)
    parts = [] if calibration is None else list(_calibration_parts(folder, calibration, documents, pictures))
    name = f"{PurePath(session).name} · " if isinstance(session, str) else ""
    instruments = ", ".join(sorted({result.instrument for result in results} - {""}))
    version = results[0].version
    return Page(
        "Instrument poses",
        f"{name}{len(results)} frame{'' if len(results) == 1 else 's'}{f' of {instruments}' if instruments else ''}"
        + (f" · dvrk-cmaes {version}" if version else ""),
        {status: sum(result.status == status for result in results) for status in reversed(_STATUSES)},
        alerts=() if calibration is None else calibration.warnings,
        notes=[*notes, *(f"In every frame: {text}" for text in common_warnings(results))],
        figures=list(session_figures(solved, summary)),
        reasons=counted_reasons(result.reasons for result in results),
        parts=[*parts, Part("Curves", charts=session_charts(results)), _settings(results)],
        entries=entries,
    )


def doubt_key(result: Result) -> tuple[int, int, float, float]:
    """Return a sort key that puts the most doubtful first: by status, number of reasons, then least overlap."""
    q = result.quality
    overlap, outline = (-1.0, math.inf) if q is None else (q.iou, q.contour_px_95)
    return _STATUSES.index(result.status), -len(result.reasons), overlap, -outline


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
    tips = [(result.expected_error.tip_90_mm, result.frame) for result in results if result.expected_error is not None]
    if tips:
        most, where = max(tips)
        figure = f"{np.median([tip for tip, _ in tips]):.2f} mm"
        yield KeyFigure("Tips within (90 %), median", figure, f"at worst {most:.1f} mm ({where})")
    seconds = [result.seconds for result in results if result.seconds and result.status != "failed"]
    if seconds:
        run = (summary.get("timing") or {}).get("run") or {}
        took = f"; {run['frames']:,} frames in {run['seconds']:.0f} s" if run.get("frames") else ""
        yield KeyFigure("Time a frame, median", f"{np.median(seconds):.2f} s", f"slowest {max(seconds):.2f} s{took}")


def session_charts(results: Sequence[Result]) -> list[Chart]:
    """Chart the joints' corrections and the tips, over time or the frames' names."""
    times = [result.time for result in results if result.time is not None]
    timed = len(times) == len(results) > 1 and max(times) > min(times)
    places = np.array(times) - min(times) if timed else np.arange(len(results), dtype=np.float64)
    across = "time from the first image, s" if timed else "frame"
    hollow = np.array([result.status != "ok" for result in results])
    bars, frames = len(results) <= _BARS_FOR_AT_MOST, [result.frame for result in results]

    def chart(title: str, up: str, curves: Mapping[str, Sequence[float]], least: float, **more: Any) -> Chart:
        stds = more.pop("stds", {})
        drawn = [
            Curve(name, places, np.array(y, np.float64), True, stds.get(name) if bars else None, frames, hollow)
            for name, y in curves.items()
        ]
        return Chart(title, across, up, drawn, names=() if timed else frames, least=least, **more)

    joints = dict.fromkeys(name for result in results for name in result.joints)
    corrections = {name: [math.degrees(_correction(result, name)) for result in results] for name in joints}
    stds = {name: np.array([(result.std_joints_deg or {}).get(name, np.nan) for result in results]) for name in joints}
    tips = np.array([np.mean(result.tips, axis=0) if result.tips else [np.nan] * 3 for result in results]) * 1e3
    charts = [
        chart(
            "Joint corrections",
            "found - read, deg",
            corrections,
            1.0,
            stds=stds,
            note="Found less read; bars are one standard deviation, hollow points are not ok.",
        )
    ]
    if np.isfinite(tips).all(axis=1).sum() > 1:
        off = tips - np.nanmedian(tips, axis=0)
        note = "Mean of the tips, mm from its median: x right, y down, z forward."
        curves = {axis: off[:, k].tolist() for k, axis in enumerate("xyz")}
        charts.append(chart("Tips in the camera", "mm from the median", curves, 1.0, note=note))
    return charts


def _correction(result: Result, joint: str) -> float:
    """Return a joint's found less read, rad; NaN if it was not read or not found."""
    return result.joints.get(joint, math.nan) - result.readings.get(joint, math.nan)


def _settings(results: Sequence[Result]) -> Part:
    """Return what the results were computed with."""
    made = Counter((r.version, r.instrument, r.seed, json.dumps(r.config, sort_keys=True)) for r in results)
    rows = [(str(count), *map(str, kind[:3])) for kind, count in made.most_common()]
    notes = ["The settings are in the JSON of each result."]
    if len(rows) > 1:
        notes.append("The results were computed with different settings, a row for each: compare them with care.")
    return Part("Settings", notes=notes, tables=[Table(("frames", "version", "instrument", "seed"), rows)])


# frames


def _entries(
    folder: ResultsFolder, calibration: SessionCalibration | None, documents: Mapping[str, str], pictures: Pictures
) -> list[Entry]:
    """Return the frames' entries, the most doubtful first; only those that have a file of their name have pictures."""
    ranked = sorted(folder.frames.values(), key=doubt_key)  # stable: by name where the doubts are equal
    entries = []
    for place, result in enumerate(ranked):
        shown: list[Picture] = []
        if result.frame in documents:
            shown = pictures.of(overlay_path(folder.folder, result.frame))
            if calibration is not None and shown:
                shown += pictures.of(
                    left_out_path(folder.folder, result.frame), "as the session's other frames predict it"
                )
        entries.append(
            Entry(
                result.frame,
                result.status,
                shown,
                list(_lines(result, calibration)),
                result.reasons,
                [*result.warnings, *(f"not used: {text}" for text in result.unused)],
                list(_tables(result)) if place < _MOST_DETAILS else (),
                documents.get(result.frame, ""),
            )
        )
    return entries


def _lines(result: Result, calibration: SessionCalibration | None) -> Iterator[str]:
    """Yield what an entry says of a frame."""
    if result.expected_error is not None:
        yield result.expected_error.in_words
    quality = result.quality
    yield "no pose" if quality is None else f"IoU {quality.iou:.3f}, outline {quality.contour_px_95:.1f} px at 95 %"
    if result.mode_probability is not None:
        yield f"right mode: {result.mode_probability:.0%}"
    if calibration is not None:
        if result.frame in calibration.left_out:
            yield f"left out of the calibration: {calibration.left_out[result.frame]}"
        if result.frame in calibration.leave_one_out:
            iou, contour = calibration.leave_one_out[result.frame]
            yield f"predicted by the others: IoU {iou:.3f}, outline {contour:.1f} px"


def _tables(result: Result) -> Iterator[Table]:
    """Yield the tables of a frame: pose, joints and other modes."""
    rows: list[Sequence[str]] = []
    if result.camera_from_root is not None:
        rows += _pose_rows(result.root_link, result.camera_from_root, _std(result.covariance_in_camera()))
        rows += [(f"tip {k}, mm", *_three(1e3 * tip)) for k, tip in enumerate(result.tips, start=1)]
    if result.camera_from_base is not None:
        rows += _pose_rows("arm's base (RCM)", result.camera_from_base)
    if rows:
        yield Table(("pose in the camera", "x", "y", "z"), rows)
    std = result.std_joints_deg or {}
    joints = []
    for name in dict.fromkeys([*result.joints, *result.readings]):
        factor, unit = (1e3, "mm") if name.endswith("insertion") else (180 / math.pi, "deg")
        found, read = result.joints.get(name, math.nan), result.readings.get(name, math.nan)
        cells = fixed(factor * found, 2), fixed(std.get(name), 2), fixed(factor * read, 2)
        joints.append((f"{name}, {unit}", *cells, fixed(factor * (found - read), 2, sign=True)))
    if joints:
        yield Table(("joints", "found", "std", "read", "found - read"), joints)
    if result.alternatives:
        others = []
        for other in result.alternatives:
            apart = turned = math.nan
            if result.camera_from_root is not None:
                apart = 1e3 * float(np.linalg.norm(other.camera_from_root[:3, 3] - result.camera_from_root[:3, 3]))
                turned = math.degrees(float(rotation_angle(other.camera_from_root, result.camera_from_root)))
            cells = f"{other.iou:.4f}", f"{other.loss:.4g}", fixed(other.reading_distance_deg, 1)
            others.append((other.relation, *cells, fixed(apart, 1), fixed(turned, 1)))
        yield Table(("other mode", "IoU", "loss", "from readings, deg", "apart, mm", "turned, deg"), others)


def _pose_rows(
    name: str, pose: Float64, std: Float64 | None = None, axes: str = "the camera's axes"
) -> Iterator[Sequence[str]]:
    """Yield the rows of a pose (4, 4), and of its standard deviations (6,), m and rad, along and about some axes."""
    yield f"{name}: position, mm", *_three(1e3 * pose[:3, 3])
    if std is not None:
        yield f"std along {axes}, mm", *_three(1e3 * std[:3])
    yield f"{name}: axis-angle, deg", *_three(np.degrees(log_rotation(pose[:3, :3])))
    if std is not None:
        yield f"std about {axes}, deg", *_three(np.degrees(std[3:6]))


def _std(covariance: Float64 | None) -> Float64 | None:
    """Return the standard deviations of a covariance; None without one."""
    return None if covariance is None else np.sqrt(np.diag(covariance))


def _three(values: Float64) -> tuple[str, ...]:
    return tuple(fixed(float(value), 2) for value in values)


# the calibration


def _calibration_parts(
    folder: ResultsFolder, found: SessionCalibration, documents: Mapping[str, str], pictures: Pictures
) -> Iterator[Part]:
    """Yield what the page says of a calibration: base and offsets, and each frame as the others predict it."""
    std, base = np.sqrt(np.diag(found.covariance)), found.camera_from_base
    rows = list(_pose_rows("arm's base (RCM)", base, _std(in_parent(base, found.covariance))))
    moves = found.endoscope
    if moves is not None:
        for stand in moves.bases:
            rows += _pose_rows(f"frames {stand.first} to {stand.last}", stand.camera_from_base)
        for name, pose, deviations in (
            ("camera in the endoscope's tip", moves.tip_from_camera, moves.std_tip_from_camera),
            ("arm's base in that of the endoscope's arm", moves.ecm_from_base, moves.std_ecm_from_base),
        ):
            if pose is not None:
                rows += _pose_rows(name, pose, np.array(deviations), "its own axes")
    offsets = []
    for (name, offset), of_offset in zip(found.offsets.items(), std[6:].tolist(), strict=True):
        factor, unit = (1e3, "mm") if name == "insertion" else (180 / math.pi, "deg")
        values = fixed(factor * of_offset, 2), fixed(factor * found.spreads.get(name, 0.0), 2)
        offsets.append((f"{name}, {unit}", fixed(factor * offset, 2, sign=True), *values))
    note = f"One place of the arm's base and one offset a joint, from {len(found.frames)} frames solved together."
    if (folder.folder / ALONE / "report.html").is_file():
        note += f" The same frames, each solved by itself: {ALONE}/report.html."
    cables = () if found.cables is None else found.cables.in_words()
    yield Part(
        f"Calibration: {found.status}",
        figures=list(_calibration_figures(found)),
        notes=[note, *found.in_words(), *cables, *(f"Not determined by this session: {text}" for text in found.untold)],
        tables=[
            Table(("arm's base in the camera", "x", "y", "z"), rows),
            Table(("true = read + offset", "offset", "std", "std between frames"), offsets),
            Table(("left out", "why"), list(found.left_out.items()), frames=True),
        ],
        charts=[_lag_chart(found), *_cable_charts(folder, found)],
    )
    predictions = sorted((iou, name, px) for name, (iou, px) in found.leave_one_out.items() if name in folder.frames)
    if not predictions:
        return
    shown: list[Picture] = []
    for iou, name, px in predictions[:_MOST_PREDICTIONS]:
        if name in documents:
            caption = f"{name}: IoU {iou:.3f}, {px:.1f} px"
            shown += pictures.of(left_out_path(folder.folder, name), caption, widest=480)
    table = []
    for iou, name, px in predictions:
        result = folder.frames[name]
        together = None if result.quality is None else result.quality.iou
        table.append((name, f"{iou:.3f}", f"{px:.1f}", fixed(together, 3), result.status))
    yield Part(
        "Leave one out: each frame as the others predict it, the worst first",
        notes=[
            "Its image has no part in its prediction, only its readings have: a check that needs no truth. Yellow: the "
            "mask; pink: the prediction."
        ],
        pictures=shown,
        tables=[Table(("frame", "IoU", "outline, median px", "IoU solved together", "status"), table, frames=True)],
    )


def _calibration_figures(found: SessionCalibration) -> Iterator[KeyFigure]:
    """Yield the key figures of a calibration."""
    left = len(found.left_out)
    total = len(found.frames) + left
    yield KeyFigure("Frames used", f"{len(found.frames)} of {total}", f"{left} left out" if left else "none left out")
    if found.leave_one_out:
        overlaps = {name: iou for name, (iou, _) in found.leave_one_out.items()}
        contours = {name: px for name, (_, px) in found.leave_one_out.items()}
        worst, far = min(overlaps, key=lambda name: overlaps[name]), max(contours, key=lambda name: contours[name])
        mean, median = np.mean(list(overlaps.values())), np.median(list(contours.values()))
        yield KeyFigure("Predicted by the others, IoU", f"{mean:.3f}", f"mean; lowest {overlaps[worst]:.3f} ({worst})")
        note = f"median; worst {contours[far]:.1f} px ({far})"
        yield KeyFigure("Predicted by the others, outline", f"{median:.1f} px", note)
    std = np.sqrt(np.diag(found.covariance))
    yield KeyFigure("RCM, standard deviation", f"{1e3 * std[:3].max():.2f} mm", "along the base's least certain axis")
    note = "about the base's least certain axis"
    yield KeyFigure("Base's rotation, standard deviation", f"{np.degrees(std[3:6].max()):.2f}°", note)


def _lag_chart(found: SessionCalibration) -> Chart | None:
    """Chart the disagreement of the frames over the lag; None if no lag was searched."""
    curve = found.lag_curve
    if curve is None or len(curve.lags) < 2:
        return None
    note = "Mean squared disagreement of the frames with one base, in expected errors, were the images this late."
    unit = "s" if curve.unit == "s" else "frames"
    return Chart(
        "How late the images are", f"lag, {unit}", "disagreement", [Curve("", curve.lags, curve.misfit)], note=note
    )


def _cable_charts(folder: ResultsFolder, found: SessionCalibration) -> Iterator[Chart]:
    """Yield charts of the joints' errors, as they were found and as the other frames predict them."""
    cables = found.cables
    if cables is None:
        return
    for index, joint in enumerate(cables.joints):
        read, errors = [], []
        for name, corrections in cables.corrections.items():
            result = folder.frames.get(name)
            if result is not None and not math.isnan(off := _correction(result, joint)):
                read.append(math.degrees(result.readings[joint]))
                errors.append((math.degrees(off), math.degrees(found.offsets[joint] + corrections[index])))
        if read:
            x, (measured, predicted) = np.array(read), np.array(errors).T
            curves = [Curve("found", x, measured, True), Curve("predicted by the other frames", x, predicted, True)]
            yield Chart(f"Cables: {joint}", f"reading of {joint}, deg", "error, deg", curves, least=1.0)
