"""The calibration by which a recording is followed: solved from keyframes, or the reason that there is none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.calibrate import SolvedSession, begin_arm
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Place
from dvrk_cmaes.calibration.first_frames import predict_from_first
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.model import outer_readings
from dvrk_cmaes.calibration.session_doubts import bad_predictions
from dvrk_cmaes.calibration.session_state import SessionProblem, SessionState
from dvrk_cmaes.calibration.together import Begun
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.runs.track_clock import series_of
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.histogram_ratio import ColourModel
from dvrk_cmaes.track.image_masks import colours_document, read_colours
from dvrk_cmaes.track.keyframes import (
    LEAST_KEYFRAMES,
    MOST_KEYFRAMES,
    MaskShape,
    choose_keyframes,
    has_outer_joints,
    solved_with,
    well_in_view,
)
from dvrk_cmaes.track.reading_buffer import frozen_frames

KEYFRAMES: Final = "keyframes.json"
"""Solution of keyframes with masks."""
KEYFRAMES_BY_IMAGES: Final = "keyframes_images.json"
"""Solution of keyframes whose masks were found in their images, and the colours that they tell."""
_EXPECTED: Final = "the solution of a recording's keyframes"
SEARCHED: Final = 16  # keyframes that are searched for; the others start from where these expect them
_OVERLAP_LOSS: Final = 0.06  # below the overlap of the frames that were searched for, from which on one is as well
_REFUSED: Final = "session: "  # begins what `calibrate_session` says of a session that it cannot solve


@dataclass(frozen=True, eq=False)
class RecordedFrames:
    """The frames of a recording that are followed, with what is measured once.

    ``shapes`` are those of the masks, ``times`` (N,) s, ``names`` the K joints that are read, ``readings`` (N, K), NaN
    without one; ``frozen`` (N,) tells where the outer joints' readings stand still while the mask moves. ``centres``
    (N, 2) are those of the masks, px, NaN without one.
    """

    files: tuple[FrameFiles, ...]
    rig: Rig
    series: ReadingSeries | None
    times: Float64
    shapes: list[MaskShape]
    names: tuple[str, ...]
    readings: Float64
    frozen: Bool
    centres: Float64

    @classmethod
    def of(
        cls, files: tuple[FrameFiles, ...], rig: Rig, series: ReadingSeries | None, times: Float64
    ) -> RecordedFrames:
        """Measure the masks of frames; InputError names a file that is wrong."""
        shown = ((i, read_shown(own, rig)) for i, own in enumerate(files))
        masks = ((i, None if data is None else data.mask) for i, data in shown)
        return cls.of_readings(files, rig, series, times).measured(masks)

    @classmethod
    def of_readings(
        cls, files: tuple[FrameFiles, ...], rig: Rig, series: ReadingSeries | None, times: Float64
    ) -> RecordedFrames:
        """Return frames of whose masks nothing is known."""
        names = tuple(dict.fromkeys(name for own in files for name in own.readings))
        readings = np.array([[own.readings.get(name, np.nan) for name in names] for own in files])
        shapes, still = [MaskShape(0.0, 1.0)] * len(files), np.zeros(len(files), np.bool_)
        return cls(files, rig, series, times, shapes, names, readings, still, np.full((len(files), 2), np.nan))

    def measured(self, masks: Iterable[tuple[int, Bool | None]]) -> RecordedFrames:
        """Return the frames with the shapes of masks, which are given with the numbers of their frames."""
        shapes, centres = [MaskShape(0.0, 1.0)] * len(self.files), np.full((len(self.files), 2), np.nan)
        for i, mask in masks:
            if mask is not None and mask.any():
                shapes[i], (rows, columns) = MaskShape.of(mask), np.nonzero(mask)
                centres[i] = columns.mean(), rows.mean()
        outer = outer_readings([own.readings for own in self.files])
        frozen = frozen_frames(outer, centres, self.rig.views[0].camera.width)
        return replace(self, shapes=shapes, frozen=frozen, centres=centres)

    @property
    def trusted(self) -> Bool:
        """Which frames (N,) have readings of all outer joints that are not frozen."""
        return has_outer_joints(self.names, self.readings) & ~self.frozen

    def keyframes(self, most: int = MOST_KEYFRAMES) -> list[int]:
        """Choose at most some keyframes: well in view, with readings that are not frozen, far from each other."""
        usable = well_in_view(self.shapes) & self.trusted
        return choose_keyframes(usable, self.times, self.names, self.readings, most)


def with_keyframes(session: Session, most: int) -> Session:
    """Return a session with at most some of its frames: those well in view, far from each other.

    Raises
    ------
    InputError
        A file of a frame is wrong; no frame is well in view and has readings of all outer joints.
    """
    series = series_of(session)
    times = np.array([0.0 if series is None else series.frames[own.name] for own in session.frames])
    recorded = RecordedFrames.of(session.frames, session.rig, series, times)
    frames = tuple(session.frames[i] for i in recorded.keyframes(most))
    if not frames:
        raise InputError(
            f"{session.folder}: --keyframes: expected frames well in view with readings of all outer joints, got none"
        )
    return replace(session, frames=frames)


def read_shown(files: FrameFiles, rig: Rig) -> FrameData | None:
    """Read a frame without its images; None if no view has a mask that shows something."""
    if files.problem is not None:
        raise InputError(files.problem)
    masks = [own.mask for own in files.of_views(rig).values() if own.mask is not None]
    if not masks:
        return None
    without = files.changed(image=None)
    try:
        return read_frame(without, rig, blank=True)
    except InputError as error:
        if len(rig.views) > 1 and "mask is empty" in str(error):
            return None
        raise


@dataclass(frozen=True, eq=False)
class RecordedKeyframe:
    """A keyframe: its number in the recording, its files, and the function that reads its data, which is picklable.

    ``start`` is where its instrument is expected, if that is known. A pose found from there counts if its overlap with
    the mask is at least ``least_iou``.
    """

    number: int
    files: FrameFiles
    read: Callable[[], FrameData]
    start: Posed | None = None
    least_iou: float = 0.0


def alone_task(body: Body, config: EstimateConfig, keyframe: RecordedKeyframe, *, arm: Arm) -> Result:
    """Estimate a keyframe by itself, as `batch` does: from where it is expected, or else by a search."""
    files, data, method = keyframe.files, keyframe.read(), FrameMethod(arm, config)
    if keyframe.start is not None:
        started = replace(files, start=_as_result(keyframe.start, body, files.name))
        result = estimate_frame(started, data, body, method)
        if result.quality is not None and result.quality.iou >= keyframe.least_iou:
            return result
    return estimate_frame(files, data, body, method)


def _as_result(at: Posed, body: Body, name: str) -> Result:
    """Return an expected pose as a result that an estimate may start from."""
    instrument = body.instrument
    return Result(
        frame=name,
        status="doubtful",
        reasons=("expected",),
        **instrument.stated,
        camera_from_root=at.pose,
        joints=dict(zip(instrument.joint_names, at.joints.tolist(), strict=True)),
        readings={},
    )


def begin_keyframes(
    recorded: RecordedFrames, work: SessionProblem, places: Sequence[Place] = ()
) -> Begun[SessionCalibration | str]:
    """Estimate the keyframes of a recording alone and solve them together; a text says why that is not possible.

    Finish it by `solved_together` or `solved_alone`; ``places`` are as in `begin_arm`.
    """
    chosen = {i: recorded.files[i] for i in recorded.keyframes()}
    keyframes = [RecordedKeyframe(i, own, partial(read_frame, own, recorded.rig)) for i, own in chosen.items()]
    begun = begin_chosen(recorded, keyframes, work, places=places)
    return begun.then(lambda solved: solved if isinstance(solved, str) else solved.calibration)


def begin_chosen(
    recorded: RecordedFrames,
    keyframes: Sequence[RecordedKeyframe],
    work: SessionProblem,
    least: int = LEAST_KEYFRAMES,
    places: Sequence[Place] = (),
) -> Begun[SolvedSession | str]:
    """Estimate keyframes alone and solve them together; a text says why that is not possible or not to be used.

    ``least`` is the number of keyframes that are needed, ``places`` are as in `begin_arm`.
    """
    if len(keyframes) < least:
        since = recorded.files[int(recorded.frozen.argmax())].name
        frozen = f" (readings frozen since frame {since})" if recorded.frozen.any() else ""
        return Begun.of(f"{len(keyframes)} frames are well in view and have readings{frozen}, fewer than {least}")
    work.progress("estimating keyframes", len(keyframes))
    problem = replace(work, series=recorded.series, gathered={})
    frames = _estimated(recorded, keyframes, problem)
    problem = replace(problem, config=solved_with(work.config), gathered={})
    begun: Begun[SolvedSession | str]
    with _texts_of_refusals() as refused:
        begun = begin_arm(frames, problem, places).then(lambda found: bad_predictions(found[0].calibration) or found[0])
    return Begun.of(refused[0]) if refused else Begun(partial(_finished_or_refused, begun), begun.state)


def _finished_or_refused(begun: Begun[SolvedSession | str], others: Sequence[SessionState]) -> SolvedSession | str:
    """Finish keyframes that are solved by themselves; a text says why that is not possible."""
    with _texts_of_refusals() as refused:
        return begun.finish(others)
    return refused[0]


@contextmanager
def _texts_of_refusals() -> Iterator[list[str]]:
    """Keep why a session cannot be solved in the list; an error of a file that is missing or damaged is raised."""
    texts: list[str] = []
    try:
        yield texts
    except InputError as error:
        if not str(error).startswith(_REFUSED):
            raise
        texts.append(str(error).removeprefix(_REFUSED))


def _estimated(
    recorded: RecordedFrames, keyframes: Sequence[RecordedKeyframe], problem: SessionProblem
) -> list[SessionFrame]:
    """Estimate keyframes alone: some by a search, the others from where these expect them."""

    def in_session(one: RecordedKeyframe, result: Result) -> SessionFrame:
        return SessionFrame(one.files.name, one.read, result, one.files.keypoints, one.files.time)

    searched = set(recorded.keyframes(SEARCHED))
    some, rest = ([one for one in keyframes if (one.number in searched) == kind] for kind in (True, False))
    alone = partial(alone_task, arm=problem.arm)
    results = problem.run(alone, some)
    first = {one.number: in_session(one, result) for one, result in zip(some, results, strict=True)}
    readings = {one.files.name: one.files.readings for one in rest}
    expected = predict_from_first(list(first.values()), readings, problem)
    overlaps = [result.quality.iou for result in results if result.quality is not None]
    least = float(np.median(overlaps)) - _OVERLAP_LOSS if overlaps else 1.0
    rest = [replace(one, start=expected.get(one.files.name), least_iou=least) for one in rest]
    others = {one.number: in_session(one, result) for one, result in zip(rest, problem.run(alone, rest), strict=True)}
    return [frame for _, frame in sorted((first | others).items())]


def read_keyframes(
    path: Path, *, colours: bool
) -> tuple[SessionCalibration, dict[str, ColourModel] | None] | str | None:
    """Read what a run has found, from its file, with the ``colours`` of a recording's images; None without a file.

    A text says why nothing was found. InputError if the file has not what was to be found.
    """
    if not path.exists():
        return None
    document = read_json_object(path, expected=_EXPECTED)
    if isinstance(refused := document.get("refused"), str):
        return refused
    if not isinstance(calibration := document.get("calibration"), dict):
        raise InputError(f"{path}: calibration: expected a session's calibration, got none: begin with --overwrite")
    try:
        models = read_colours(document["colours"]) if colours else None
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(f"{path}: colours: expected those of a recording's views: begin with --overwrite") from None
    return SessionCalibration.from_dict(calibration, where=str(path)), models


def write_keyframes(
    path: Path, found: SessionCalibration | str, colours: Mapping[str, ColourModel] | None = None
) -> None:
    """Write what was found, with the colours of a recording's images by view."""
    refused, calibration = (found, None) if isinstance(found, str) else (None, found.to_dict())
    more = {} if colours is None else {"colours": colours_document(colours)}
    write_json(path, {"refused": refused, "calibration": calibration, **more})
