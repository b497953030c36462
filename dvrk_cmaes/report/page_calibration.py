"""The page's section on a session's calibration: base and offsets with standard deviations, leave-one-out predictions.

A leave-one-out prediction is the silhouette of a frame computed from the other frames and its readings, without its
image; its overlap with the frame's mask measures accuracy without true poses. The overlap of frames that were solved
together does not, since each frame's own mask was used to solve it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.geometry import Float64, change_between
from dvrk_cmaes.report.page_frames import LeaveOneOut
from dvrk_cmaes.report.page_layers import embedded_picture
from dvrk_cmaes.report.page_session import KeyFigure, correction
from dvrk_cmaes.report.plots.cables import cables_plot
from dvrk_cmaes.report.plots.lag import lag_plot
from dvrk_cmaes.report.plots.offsets import offset_estimates, offset_panels
from dvrk_cmaes.report.plots.shafts import shafts_plot
from dvrk_cmaes.results.folder import ALONE, ResultsFolder
from dvrk_cmaes.results.paths import left_out_path
from dvrk_cmaes.results.result import Result

MOST_PICTURES = 12
"""Number of predictions whose pictures are shown in the section, the worst first; all are shown with their frames."""

_SMALL = 400  # px, width of these pictures


class LeftOutFrame(NamedTuple):
    """Overlap and median contour distance, px, of the mask of a frame and its silhouette predicted by the others."""

    frame: str
    iou: float
    contour_px: float


def left_out_views(
    folder: ResultsFolder, calibration: SessionCalibration, names: Iterable[str]
) -> dict[str, LeaveOneOut]:
    """Collect leave-one-out predictions and reasons for leaving frames out, by frame.

    ``names`` are the frames whose names are those of their result files; only these have pictures.
    """
    files = set(names)
    found = {}
    for name in folder.frames:
        path = left_out_path(folder.folder, name)
        there = name in files and path.is_file()
        iou, contour = calibration.leave_one_out.get(name, (None, None))
        picture = quote(path.relative_to(folder.folder).as_posix(), errors="replace") if there else None
        reason = calibration.left_out.get(name, "")
        if picture or reason or iou is not None:
            found[name] = LeaveOneOut(iou, contour, picture, reason)
    return found


def calibration_view(
    folder: ResultsFolder, calibration: SessionCalibration, left_out: Mapping[str, LeaveOneOut]
) -> SimpleNamespace:
    """Return what the template says of a calibration; ``left_out`` is that of `left_out_views`.

    figures : key figures. words : what the frames tell of lag, cameras and masks. base_std : standard deviations
    (3,) of the base, mm and deg. endoscope : poses that it tells. offsets : in deg and mm.
    matrix : camera_from_base as text, m. beyond : whether a frame lies outside the plot of offsets.
    results : by frame. predictions : the worst first. pictures : those of which a picture is shown, with its address.
    left_out : frames left out of the calibration: name, reason, and whether the page has the frame.
    alone : address of the page of the same frames solved one by one, None if it does not exist.
    """
    results = list(folder.frames.values())
    used = frozenset(place for place, name in enumerate(folder.frames) if name in calibration.frames)
    unsure = frozenset(place for place, result in enumerate(results) if result.status != "ok")
    std = np.sqrt(np.diag(calibration.covariance))
    predicted = calibration.leave_one_out.items()
    predictions = [LeftOutFrame(name, *measured) for name, measured in predicted if name in folder.frames]
    predictions.sort(key=lambda prediction: (prediction.iou, prediction.frame))
    pictured = [one for one in predictions if left_out[one.frame].picture][:MOST_PICTURES]
    poses = {place: r.camera_from_root for place, r in enumerate(results) if r.camera_from_root is not None}
    posed = {place: pose for place, pose in poses.items() if place in used or results[place].frame in left_out}
    panels = offset_panels(calibration, _corrections(results, calibration, used), unsure)
    return SimpleNamespace(
        calibration=calibration,
        figures=tuple(_figures(calibration, predictions)),
        words=tuple(calibration.in_words()),
        base_std=(1e3 * std[:3], np.degrees(std[3:6])),
        endoscope=tuple(_endoscope(calibration)),
        matrix="\n".join("  ".join(f"{value:12.9f}" for value in row) for row in calibration.camera_from_base),
        offsets=tuple(offset_estimates(calibration)),
        offset_panels=panels,
        beyond=any(mark.beyond for panel in panels for row in panel.rows for mark in row.marks),
        shafts=shafts_plot(calibration, posed, used),
        results=folder.frames,
        predictions=predictions,
        pictures=[
            (one, embedded_picture(left_out_path(folder.folder, one.frame), _SMALL) or left_out[one.frame].picture)
            for one in pictured
        ],
        left_out=tuple((name, reason, name in folder.frames) for name, reason in calibration.left_out.items()),
        cables=() if calibration.cables is None else tuple(calibration.cables.in_words()),
        cables_plot=cables_plot(results, calibration, used),
        lag_plot=lag_plot(calibration),
        alone=f"{ALONE}/report.html" if (folder.folder / ALONE / "report.html").is_file() else None,
    )


def _figures(calibration: SessionCalibration, predictions: Sequence[LeftOutFrame]) -> Iterator[KeyFigure]:
    """Yield the key figures of the calibration."""
    total = len(calibration.frames) + len(calibration.left_out)
    left = len(calibration.left_out)
    yield KeyFigure(
        "Frames used", f"{len(calibration.frames)} of {total}", f"{left} left out" if left else "none left out"
    )
    if predictions:
        worst = predictions[0]
        yield KeyFigure(
            "Predicted by the others, IoU",
            f"{np.mean([prediction.iou for prediction in predictions]):.3f}",
            f"mean; lowest {worst.iou:.3f} ({worst.frame})",
        )
        far = max(predictions, key=lambda prediction: prediction.contour_px)
        yield KeyFigure(
            "Predicted by the others, outline",
            f"{np.median([prediction.contour_px for prediction in predictions]):.1f} px",
            f"median; worst {far.contour_px:.1f} px ({far.frame})",
        )
    std = np.sqrt(np.diag(calibration.covariance))
    yield KeyFigure("RCM, standard deviation", f"{1e3 * std[:3].max():.2f} mm", "along the base's least certain axis")
    yield KeyFigure(
        "Base's rotation, standard deviation",
        f"{np.degrees(std[3:6].max()):.2f}°",
        "about the base's least certain axis",
    )


def _endoscope(calibration: SessionCalibration) -> Iterator[tuple[str, Float64, Float64, Float64]]:
    """Yield the poses (4, 4) that a moving endoscope tells: name, pose, and standard deviations (3,) in mm and deg."""
    moves = calibration.endoscope
    if moves is None or moves.tip_from_camera is None or moves.ecm_from_base is None:
        return
    for name, pose, deviations in (
        ("camera in the endoscope's tip", moves.tip_from_camera, moves.std_tip_from_camera),
        ("arm's base in that of the endoscope's arm", moves.ecm_from_base, moves.std_ecm_from_base),
    ):
        own = np.array(deviations)
        yield name, pose, 1e3 * own[:3], np.degrees(own[3:])


def _corrections(
    results: Sequence[Result], calibration: SessionCalibration, used: frozenset[int]
) -> dict[str, dict[int, float]]:
    """Compute found less read of each joint with an offset, rad or m, by joint and index of the frame.

    For insertion and roll, the found value is the one that moves the predicted pose along and about the shaft to the
    estimated pose.
    """
    joints = tuple(calibration.offsets)[2:]
    found: dict[str, dict[int, float]] = {name: {} for name in calibration.offsets}
    for place in sorted(used):
        result = results[place]
        for joint in joints:
            change = correction(result, joint)
            if change is not None:
                found[joint][place] = change
        outer = outer_readings([result.readings])
        if result.camera_from_root is None or np.isnan(outer).any():
            continue
        placed = calibration.at(result.readings, frame=result.frame, time=result.time)
        if isinstance(placed, str):
            continue
        model, constants = placed.model(outer, np.full((1, len(joints)), np.nan), joints)
        change_of_root = change_between(model.predict(constants).pose[0], result.camera_from_root)
        expected = constants.offsets[1] + model.correction.values[0, 0]
        found["insertion"][place] = float(constants.offsets[0] + change_of_root[2])
        found["roll"][place] = float(expected + change_of_root[5])
    return found
