"""What the page says of a session's calibration: its base and offsets, how sure they are, and how each frame fits in.

Leave one out: what the other frames predict for a frame, without its image, against its mask. It needs no truth, and
cannot flatter itself as the overlap of frames that were solved together does.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration import SessionCalibration
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.geometry import change_between
from dvrk_cmaes.report.page_frames import LeftOut, Row, axis_angle, fixed, signed
from dvrk_cmaes.report.page_offsets_plot import OffsetPanel, amounts, offset_panels
from dvrk_cmaes.report.page_session import Figure, correction
from dvrk_cmaes.report.page_shafts_plot import ShaftsPlot, shafts_plot
from dvrk_cmaes.results.folder import ALONE, SESSION, ResultsFolder
from dvrk_cmaes.results.paths import left_out_path
from dvrk_cmaes.results.result import Result

Float64 = NDArray[np.float64]

MOST_PICTURES = 12
"""Of predictions that are shown beside each other, the worst; each is with its frame, too."""


@dataclass(frozen=True)
class Prediction:
    """What the other frames predict for a frame, and the overlap of its own solution."""

    frame: str
    status: str
    iou: float
    contour_px: float
    own_iou: float | None
    picture: str | None


@dataclass(frozen=True)
class CalibrationView:
    """A session's calibration as the template shows it.

    base, offsets : rows of tables; matrix : camera_from_base, m. predictions : worst first; pictures : those of them
    that are shown. left_out : frame, reason and whether it has a place on the page. alone : address of the page of the
    frames solved by themselves, None where it is not there.
    """

    calibration: SessionCalibration
    figures: tuple[Figure, ...]
    base: tuple[Row, ...]
    matrix: str
    offsets: tuple[Row, ...]
    offset_panels: tuple[OffsetPanel, ...]
    shafts: ShaftsPlot | None
    predictions: tuple[Prediction, ...]
    pictures: tuple[Prediction, ...]
    left_out: tuple[tuple[str, str, bool], ...]
    lag: str
    alone: str | None

    @property
    def beyond(self) -> bool:
        """Whether a frame lies outside the plot of offsets."""
        return any(mark.beyond for panel in self.offset_panels for row in panel.rows for mark in row.marks)


def calibration_of(folder: ResultsFolder) -> SessionCalibration | None:
    """Take the session's calibration of a folder, if there is one; InputError where it is damaged."""
    if folder.session is None:
        return None
    return SessionCalibration.from_dict(folder.session, where=str(folder.folder / SESSION))


def left_out_views(folder: ResultsFolder, calibration: SessionCalibration, names: Iterable[str]) -> dict[str, LeftOut]:
    """Say by frame what leaving it out says of it; ``names`` are those of frames that are also names of files."""
    files = set(names)
    found = {}
    for name in folder.frames:
        path = left_out_path(folder.folder, name)
        there = name in files and path.is_file()
        iou, contour = calibration.leave_one_out.get(name, (None, None))
        picture = quote(path.relative_to(folder.folder).as_posix(), errors="replace") if there else None
        reason = calibration.left_out.get(name, "")
        if picture or reason or iou is not None:
            found[name] = LeftOut(iou, contour, picture, reason)
    return found


def calibration_view(
    folder: ResultsFolder, calibration: SessionCalibration, left_out: Mapping[str, LeftOut]
) -> CalibrationView:
    """Put a calibration in words, numbers and drawings."""
    results = list(folder.frames.values())
    used = frozenset(place for place, name in enumerate(folder.frames) if name in calibration.frames)
    unsure = frozenset(place for place, result in enumerate(results) if result.status != "ok")
    predictions = sorted(_predictions(folder.frames, calibration, left_out), key=lambda one: (one.iou, one.frame))
    poses = {place: r.camera_from_root for place, r in enumerate(results) if r.camera_from_root is not None}
    posed = {place: pose for place, pose in poses.items() if place in used or results[place].frame in left_out}
    return CalibrationView(
        calibration=calibration,
        figures=tuple(_figures(calibration, predictions)),
        base=tuple(_base(calibration)),
        matrix="\n".join("  ".join(f"{value:12.9f}" for value in row) for row in calibration.camera_from_base),
        offsets=tuple(_offsets(calibration)),
        offset_panels=offset_panels(calibration, _corrections(results, calibration, used), unsure),
        shafts=shafts_plot(calibration, posed, used),
        predictions=tuple(predictions),
        pictures=tuple([one for one in predictions if one.picture][:MOST_PICTURES]),
        left_out=tuple((name, reason, name in folder.frames) for name, reason in calibration.left_out.items()),
        lag=_lag(calibration),
        alone=f"{ALONE}/report.html" if (folder.folder / ALONE / "report.html").is_file() else None,
    )


def _predictions(
    results: Mapping[str, Result], calibration: SessionCalibration, left_out: Mapping[str, LeftOut]
) -> Iterator[Prediction]:
    for name, (iou, contour_px) in calibration.leave_one_out.items():
        if name in results:
            quality = results[name].quality
            own = None if quality is None else quality.iou
            yield Prediction(name, results[name].status, iou, contour_px, own, left_out[name].picture)


def _figures(calibration: SessionCalibration, predictions: Sequence[Prediction]) -> Iterator[Figure]:
    """Sum the calibration up."""
    total = len(calibration.frames) + len(calibration.left_out)
    left = len(calibration.left_out)
    yield Figure(
        "Frames used", f"{len(calibration.frames)} of {total}", f"{left} left out" if left else "none left out"
    )
    if predictions:
        worst = predictions[0]
        yield Figure(
            "Predicted by the others, IoU",
            f"{np.mean([one.iou for one in predictions]):.3f}",
            f"mean; lowest {worst.iou:.3f} ({worst.frame})",
        )
        far = max(predictions, key=lambda one: one.contour_px)
        yield Figure(
            "Predicted by the others, outline",
            f"{np.median([one.contour_px for one in predictions]):.1f} px",
            f"median; worst {far.contour_px:.1f} px ({far.frame})",
        )
    std = np.sqrt(np.diag(calibration.covariance))
    yield Figure("RCM, standard deviation", f"{1e3 * std[:3].max():.2f} mm", "along the base's least certain axis")
    yield Figure(
        "Base's rotation, standard deviation",
        f"{np.degrees(std[3:6].max()):.2f}°",
        "about the base's least certain axis",
    )


def _base(calibration: SessionCalibration) -> Iterator[Row]:
    """Position and rotation of the arm's base in the camera, with standard deviations."""
    std = np.sqrt(np.diag(calibration.covariance))

    def cells(values: Float64) -> tuple[str, ...]:
        return tuple(fixed(float(value), 2) for value in values)

    yield Row("position (RCM), mm", cells(1e3 * calibration.rcm))
    yield Row("standard deviation along its own axes, mm", cells(1e3 * std[:3]), minor=True)
    yield Row("axis-angle, deg", cells(axis_angle(calibration.camera_from_base)))
    yield Row("standard deviation about its own axes, deg", cells(np.degrees(std[3:6])), minor=True)


def _offsets(calibration: SessionCalibration) -> Iterator[Row]:
    """Offset of each joint, its standard deviation, and the spread from frame to frame."""
    for name, unit, _, amount in amounts(calibration):
        yield Row(f"{name}, {unit}", (signed(amount.offset, 2), fixed(amount.std, 2), f"± {fixed(amount.spread, 2)}"))


def _corrections(
    results: Sequence[Result], calibration: SessionCalibration, used: frozenset[int]
) -> dict[str, dict[int, float]]:
    """Found less read of each joint with an offset, rad or m, by the place of the frame.

    Insertion and roll are those along and about the shaft that lead from the base to the pose as it was found.
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
        model, constants = calibration.model(outer, np.full((1, len(joints)), np.nan), joints)
        change_of_root = change_between(model.predict(constants)[0][0], result.camera_from_root)
        found["insertion"][place] = calibration.offsets["insertion"] + float(change_of_root[2])
        found["roll"][place] = calibration.offsets["roll"] + float(change_of_root[5])
    return found


def _lag(calibration: SessionCalibration) -> str:
    """Say by how much the readings were late, if they were."""
    if not calibration.lag or not calibration.lag.get("frames"):
        return ""
    frames, seconds = calibration.lag["frames"], calibration.lag.get("seconds")
    text = f"{abs(frames):g} frame{'' if abs(frames) == 1 else 's'} {'late' if frames > 0 else 'early'}"
    return text if seconds is None else f"{text} ({abs(seconds):g} s)"
