"""The page's section on a session's calibration: base and offsets with standard deviations, leave-one-out predictions.

A leave-one-out prediction is the silhouette of a frame computed from the other frames and its readings, without its
image; its overlap with the frame's mask measures accuracy without true poses. The overlap of frames that were solved
together does not, since each frame's own mask was used to solve it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from urllib.parse import quote

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.geometry import Float64, change_between
from dvrk_cmaes.report.page_frames import LeaveOneOut, TableRow, axis_angle, fixed, signed
from dvrk_cmaes.report.page_layers import embedded_picture
from dvrk_cmaes.report.page_session import KeyFigure, correction
from dvrk_cmaes.report.plots.cables import cables_plot
from dvrk_cmaes.report.plots.lag import LagPlot, lag_plot
from dvrk_cmaes.report.plots.offsets import OffsetPanel, offset_estimates, offset_panels
from dvrk_cmaes.report.plots.panels import Plot
from dvrk_cmaes.report.plots.shafts import ShaftsPlot, shafts_plot
from dvrk_cmaes.results.folder import ALONE, SESSION, ResultsFolder
from dvrk_cmaes.results.paths import left_out_path
from dvrk_cmaes.results.result import Result

MOST_PICTURES = 12
"""Number of predictions whose pictures are shown in the section, the worst first; all are shown with their frames."""

_SMALL = 400  # px, width of these pictures


@dataclass(frozen=True)
class Prediction:
    """Leave-one-out prediction of a frame.

    frame, status : name and status of the frame.
    iou, contour_px : overlap and median contour distance, px, of the predicted silhouette and the mask.
    own_iou : overlap of the frame's own solution; None without a pose.
    picture : address of the picture, None if there is none.
    """

    frame: str
    status: str
    iou: float
    contour_px: float
    own_iou: float | None
    picture: str | None


@dataclass(frozen=True)
class CalibrationView:
    """Contents of the page's section on a session's calibration.

    figures : key figures. words : what the frames tell of lag, cameras and masks. base, offsets : rows of tables.
    matrix : camera_from_base as text, m.
    offset_panels, shafts : plots. predictions : the worst first. pictures : predictions whose pictures are shown.
    left_out : frames left out of the calibration: name, reason, and whether the page has the frame.
    cables : what the cables add to the offsets, in words. cables_plot : plots of the joints' errors, None if the
    session does not tell of its cables.
    lag_plot : plot of the frames' disagreement as a function of the lag, None if no lag was searched.
    alone : address of the page of the same frames solved one by one, None if it does not exist.
    """

    calibration: SessionCalibration
    figures: tuple[KeyFigure, ...]
    words: tuple[str, ...]
    base: tuple[TableRow, ...]
    matrix: str
    offsets: tuple[TableRow, ...]
    offset_panels: tuple[OffsetPanel, ...]
    shafts: ShaftsPlot | None
    predictions: tuple[Prediction, ...]
    pictures: tuple[Prediction, ...]
    left_out: tuple[tuple[str, str, bool], ...]
    cables: tuple[str, ...]
    cables_plot: Plot | None
    lag_plot: LagPlot | None
    alone: str | None

    @property
    def beyond(self) -> bool:
        """Whether a frame lies outside the plot of offsets."""
        return any(mark.beyond for panel in self.offset_panels for row in panel.rows for mark in row.marks)


def calibration_of(folder: ResultsFolder) -> SessionCalibration | None:
    """Return the session's calibration of a results folder, None if it has none; InputError if it is invalid."""
    if folder.session is None:
        return None
    return SessionCalibration.from_dict(folder.session, where=str(folder.folder / SESSION))


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
) -> CalibrationView:
    """Make the page's section on a calibration; ``left_out`` is that of `left_out_views`."""
    results = list(folder.frames.values())
    used = frozenset(place for place, name in enumerate(folder.frames) if name in calibration.frames)
    unsure = frozenset(place for place, result in enumerate(results) if result.status != "ok")
    predictions = sorted(
        _predictions(folder.frames, calibration, left_out), key=lambda prediction: (prediction.iou, prediction.frame)
    )
    poses = {place: r.camera_from_root for place, r in enumerate(results) if r.camera_from_root is not None}
    posed = {place: pose for place, pose in poses.items() if place in used or results[place].frame in left_out}
    return CalibrationView(
        calibration=calibration,
        figures=tuple(_figures(calibration, predictions)),
        words=tuple(calibration.in_words()),
        base=tuple(_base(calibration)),
        matrix="\n".join("  ".join(f"{value:12.9f}" for value in row) for row in calibration.camera_from_base),
        offsets=tuple(_offsets(calibration)),
        offset_panels=offset_panels(calibration, _corrections(results, calibration, used), unsure),
        shafts=shafts_plot(calibration, posed, used),
        predictions=tuple(predictions),
        pictures=_with_pictures(
            folder, [prediction for prediction in predictions if prediction.picture][:MOST_PICTURES]
        ),
        left_out=tuple((name, reason, name in folder.frames) for name, reason in calibration.left_out.items()),
        cables=() if calibration.cables is None else tuple(calibration.cables.in_words()),
        cables_plot=cables_plot(results, calibration, used),
        lag_plot=lag_plot(calibration),
        alone=f"{ALONE}/report.html" if (folder.folder / ALONE / "report.html").is_file() else None,
    )


def _predictions(
    results: Mapping[str, Result], calibration: SessionCalibration, left_out: Mapping[str, LeaveOneOut]
) -> Iterator[Prediction]:
    for name, (iou, contour_px) in calibration.leave_one_out.items():
        if name in results:
            quality = results[name].quality
            own = None if quality is None else quality.iou
            yield Prediction(name, results[name].status, iou, contour_px, own, left_out[name].picture)


def _with_pictures(folder: ResultsFolder, predictions: Sequence[Prediction]) -> tuple[Prediction, ...]:
    """Return predictions with small pictures within the page; the address of one that cannot be read stays."""
    small = (embedded_picture(left_out_path(folder.folder, prediction.frame), _SMALL) for prediction in predictions)
    return tuple(
        replace(prediction, picture=own or prediction.picture)
        for prediction, own in zip(predictions, small, strict=True)
    )


def _figures(calibration: SessionCalibration, predictions: Sequence[Prediction]) -> Iterator[KeyFigure]:
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


def _base(calibration: SessionCalibration) -> Iterator[TableRow]:
    """Yield rows of the position and rotation of the arm's base in the camera, with standard deviations."""
    std = np.sqrt(np.diag(calibration.covariance))

    def cells(values: Float64) -> tuple[str, ...]:
        return tuple(fixed(float(value), 2) for value in values)

    yield TableRow("position (RCM), mm", cells(1e3 * calibration.rcm))
    yield TableRow("standard deviation along its own axes, mm", cells(1e3 * std[:3]), minor=True)
    yield TableRow("axis-angle, deg", cells(axis_angle(calibration.camera_from_base)))
    yield TableRow("standard deviation about its own axes, deg", cells(np.degrees(std[3:6])), minor=True)
    if (moves := calibration.endoscope) is None:
        return
    for stand in moves.bases:
        yield TableRow(
            f"frames {stand.first} to {stand.last}: position, mm", cells(1e3 * stand.camera_from_base[:3, 3])
        )
        yield TableRow("axis-angle, deg", cells(axis_angle(stand.camera_from_base)))
    if moves.tip_from_camera is not None and moves.ecm_from_base is not None:
        for name, pose, deviations in (
            ("camera in the endoscope's tip", moves.tip_from_camera, moves.std_tip_from_camera),
            ("arm's base in that of the endoscope's arm", moves.ecm_from_base, moves.std_ecm_from_base),
        ):
            own = np.array(deviations)
            yield TableRow(f"{name}: position, mm", cells(1e3 * pose[:3, 3]))
            yield TableRow("standard deviation, mm", cells(1e3 * own[:3]), minor=True)
            yield TableRow("axis-angle, deg", cells(axis_angle(pose)))
            yield TableRow("standard deviation, deg", cells(np.degrees(own[3:])), minor=True)


def _offsets(calibration: SessionCalibration) -> Iterator[TableRow]:
    """Yield a row for each joint: its offset, the offset's standard deviation, and that from frame to frame."""
    for name, unit, _, estimate in offset_estimates(calibration):
        yield TableRow(
            f"{name}, {unit}", (signed(estimate.offset, 2), fixed(estimate.std, 2), f"± {fixed(estimate.frame_std, 2)}")
        )


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
