"""The calibration by which a recording is followed: solved from keyframes, or the reason that there is none.

Where frames have no masks, those of the keyframes are found in each image by itself. Masks that show something else
than the instrument do not agree with the others, and are left out as the keyframes are solved together.
From the keyframes' poses the colours of instrument and surroundings are learned, by which the masks of all images are
found around what is expected of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.calibrate import SolvedSession, begin_arm
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_doubts import bad_predictions
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.session_trials import predict_from_first
from dvrk_cmaes.calibration.together import Begun, Outcome
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Bool, Posed
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame, hints_of
from dvrk_cmaes.runs.recording import RecordedFrames, RecordedSolution, predict, read_seen
from dvrk_cmaes.runs.track_inputs import series_of
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import GUESS, Hints
from dvrk_cmaes.segment.shaft_pairs import prompts_in
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.frame_fits import learn_task, with_outside
from dvrk_cmaes.track.image_masks import pooled_colours
from dvrk_cmaes.track.keyframes import LEAST_KEYFRAMES, choose_keyframes

SEARCHED: Final = 16  # keyframes that are searched for; the others start from where these expect them
_OVERLAP_LOSS: Final = 0.06  # below the overlap of the frames that were searched for, from which on one is as well
_REFUSED: Final = "session: "  # begins what `calibrate_session` says of a session that it cannot solve
_SEGMENTED: Final = 60  # images, at most, that are segmented by themselves
_FEWEST: Final = 6  # keyframes whose masks were found, with which a recording is solved
_NO_COLOURS: Final = "no image shows enough of the instrument where it is expected"
_KEYFRAMES: Final = 40  # of these, at most, that are solved together


def with_keyframes(session: Session, most: int) -> Session:
    """Return a session with at most some of its frames: those well in view, far from each other.

    Raises
    ------
    InputError
        A file of a frame is wrong; no frame is well in view and has readings of all outer joints.
    """
    series = series_of(session)
    times = np.array([0.0 if series is None else series.frames[own.name] for own in session.frames])
    recorded = RecordedFrames.of(session.frames, session.rig, series, times).with_own_masks()
    frames = tuple(session.frames[i] for i in recorded.keyframes(most))
    if not frames:
        raise InputError(
            f"{session.folder}: --keyframes: expected frames well in view with readings of all outer joints, got none"
        )
    return replace(session, frames=frames)


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


def begin_keyframes(recorded: RecordedFrames, work: ArmSetup) -> Begun[RecordedSolution | str | None]:
    """Estimate the keyframes of a recording alone and solve them together; a text says why that is not possible.

    Finish it by `solved_together` or `solved_alone`.
    """
    chosen = {i: recorded.files[i] for i in recorded.keyframes()}
    keyframes = [RecordedKeyframe(i, own, partial(read_frame, own, recorded.rig)) for i, own in chosen.items()]
    begun = _begin_chosen(recorded, keyframes, work)
    return begun.then(lambda solved: solved if isinstance(solved, str) else RecordedSolution.of(recorded, solved))


def _begin_chosen(
    recorded: RecordedFrames,
    keyframes: Sequence[RecordedKeyframe],
    work: ArmSetup,
    least: int = LEAST_KEYFRAMES,
) -> Begun[SolvedSession | str]:
    """Estimate keyframes alone and solve them together; a text says why that is not possible or not to be used.

    ``least`` is the number of keyframes that are needed.
    """
    if len(keyframes) < least:
        since = recorded.files[int(recorded.frozen.argmax())].name
        frozen = f" (readings frozen since frame {since})" if recorded.frozen.any() else ""
        return Begun.of(f"{len(keyframes)} frames are well in view and have readings{frozen}, fewer than {least}")
    work.progress("estimating keyframes", len(keyframes))
    problem = replace(work, series=recorded.series)
    frames = _estimated(recorded, keyframes, problem)
    try:
        begun = begin_arm(frames, problem).then(lambda found: bad_predictions(found[0].calibration) or found[0])
    except InputError as error:
        return Begun.of(_refusal(error))

    def finished(outcome: Outcome | None) -> SolvedSession | str:
        try:
            return begun.finish(outcome)
        except InputError as error:
            return _refusal(error)

    return Begun(finished, begun.arm)


def _refusal(error: InputError) -> str:
    """Return why a session cannot be solved; an error of a file that is missing or damaged is raised."""
    if not str(error).startswith(_REFUSED):
        raise error
    return str(error).removeprefix(_REFUSED)


def _estimated(
    recorded: RecordedFrames, keyframes: Sequence[RecordedKeyframe], problem: ArmSetup
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


def segment_task(
    body: Body,
    config: EstimateConfig,
    task: tuple[FrameFiles, Hints],
    *,
    rig: Rig,
) -> FrameData | None:
    """Find the masks in the images of a frame with its hints; None where nothing is found, or only a guess.

    Masks that the frame has are kept. In further views the instrument of the first view's prompts is looked for.
    """
    files, of_frame = task
    data = read_seen(files, rig)
    if data is None:
        return None
    data = with_outside(data)
    views: list[SeenView] = []
    for number, view in enumerate(data.views):
        hints = prompts_in(view, views[0], of_frame, body) if number else of_frame
        if view.image is None or (view.given and view.mask.any()):
            views.append(replace(view, image=None))
            continue
        mask = _first_mask(view, hints)
        views.append(replace(view, image=None) if mask is None else replace(view, mask=mask, given=True, image=None))
    found = replace(data, views=tuple(views))
    return found if any(view.given and view.shows for view in found.views) else None


def _first_mask(view: SeenView, hints: Hints) -> Bool | None:
    """Find the mask of a view in its image; None where nothing is found, or only a guess."""
    assert view.image is not None
    found = segment(view.image, **vars(hints), threads=1)
    return found.mask if found.confidence >= GUESS and replace(view, mask=found.mask).shows else None


def begin_images(
    recorded: RecordedFrames,
    given: SessionCalibration | None,
    hints: Hints,
    work: ArmSetup,
) -> Begun[RecordedSolution | str | None]:
    """Find masks in images of a recording, and solve those that are well in view together; or say why not.

    With a calibration that is ``given``, the masks only tell the colours. ``hints`` hold for the first frame. Raises
    InputError for a file that is wrong.
    """
    files, times, names, readings = recorded.files, recorded.times, recorded.names, recorded.readings
    there = np.array([own.has_image or own.has_mask for own in files]) & recorded.trusted
    chosen = choose_keyframes(there, times, names, readings, _SEGMENTED)
    if given is None and len(chosen) < LEAST_KEYFRAMES:  # too few to tell masks of another tool from the right ones
        return Begun.of(f"{len(chosen)} images that differ have readings, fewer than {LEAST_KEYFRAMES}")
    work.progress("finding masks", len(chosen))
    segmented = partial(segment_task, rig=recorded.rig)
    of_frames = {i: hints if i == 0 and hints != Hints() else hints_of(files[i]) or Hints() for i in chosen}
    tasks = [(files[i], of_frame) for i, of_frame in of_frames.items()]
    found: dict[int, FrameData | None] = dict(zip(chosen, work.run(segmented, tasks), strict=True))
    recorded = recorded.measured(found.items())
    if given is not None:
        return Begun.of(_with_colours(RecordedSolution(recorded, given, {}), work, found=found))
    work = replace(work, config=work.config.with_alike_masks())
    begun = _begin_chosen(recorded, _keyframes(recorded, found), work, _FEWEST)
    return begun.then(
        lambda solved: (
            solved
            if isinstance(solved, str)
            else _with_colours(RecordedSolution.of(recorded, solved), work, results=solved.results)
        )
    )


def _keyframes(recorded: RecordedFrames, found: Mapping[int, FrameData | None]) -> list[RecordedKeyframe]:
    """Choose keyframes among the frames in which masks were found."""
    return [
        RecordedKeyframe(i, recorded.files[i].changed(image=None), partial(replace, one))
        for i in recorded.keyframes(_KEYFRAMES)
        if (one := found[i]) is not None
    ]


def _with_colours(
    solution: RecordedSolution,
    work: ArmSetup,
    *,
    found: Mapping[int, FrameData | None] | None = None,
    results: Mapping[str, Result] | None = None,
) -> RecordedSolution | str:
    """Return a calibration with the colours of instrument and surroundings; a text where the images tell none.

    They are learned at the poses of the ``results`` of keyframes that agree, or from masks that were ``found`` where
    the calibration predicts the instrument.
    """
    recorded, calibration, names = solution.recorded, solution.calibration, work.instrument.joint_names
    tasks: list[tuple[Callable[[], FrameData | None], Posed, Mapping[str, Bool] | None]] = []
    if results is not None:
        for own in recorded.files:
            if own.name in calibration.frames and own.has_image:
                at = posed(results[own.name], names)
                tasks.append((partial(read_seen, own, solution.rig), at, None))
    else:
        predicted, _ = predict(recorded, calibration, names)
        for i, one in (found or {}).items():
            own = recorded.files[i]
            if one is not None and own.has_image:
                masks = {view.name: view.mask for view in one.views if view.given}
                tasks.append((partial(read_seen, own, solution.rig), predicted.at[i], masks))
    learned = work.run(learn_task, tasks)
    of_views = {view: [of_frame[view] for of_frame in learned if view in of_frame] for view in recorded.rig.names}
    colours = {view: pooled_colours(models) for view, models in of_views.items() if models}
    return replace(solution, colours=colours) if colours else _NO_COLOURS
