"""The calibration by which a recording is followed: solved from keyframes, or the reason that there is none.

Where frames have no masks, those of some keyframes are found in each image by itself, and those of the others where
most of these expect the instrument. Masks that show something else do not agree with the others, and are left out as
the keyframes are solved together. From the keyframes' poses the colours of instrument and surroundings are learned, by
which the masks of all images are found around what is expected of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, TypeVar

import numpy as np

from dvrk_cmaes.calibration.calibrate import begin_arm
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_doubts import bad_predictions
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.session_loop import predict_from_first
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.calibration.together import Begun
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.image_frame import segment_view
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.backgrounds import by_view, with_backgrounds
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.runs.pool import Notice
from dvrk_cmaes.runs.recording import RecordedFrames, RecordedSolution, predict, read_seen
from dvrk_cmaes.segment.segmentation import GUESS, SegmentSettings
from dvrk_cmaes.segment.shaft_pairs import prompts_in
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.frame_fits import learn_task
from dvrk_cmaes.track.image_masks import pooled_colours
from dvrk_cmaes.track.keyframes import LEAST_KEYFRAMES

_REFUSED: Final = "session: "  # begins what `calibrate_session` says of a session that it cannot solve
_SEGMENTED: Final = 40  # images, at most, in which masks are found
_FEWEST: Final = 6  # keyframes whose masks were found, with which a recording is solved
_NO_COLOURS: Final = "no image shows enough of the instrument where it is expected"
_SEARCHED: Final = 16  # keyframes that are searched for; the others start from where these expect them
T = TypeVar("T")
Reader = Callable[[], FrameData]
"""A picklable function that reads a frame's data."""


def with_keyframes(session: Session, most: int) -> Session:
    """Return a session with at most some of its frames: those well in view, far from each other.

    Raises
    ------
    InputError
        A file of a frame is wrong; no frame is well in view and has readings of all outer joints.
    """
    recorded = RecordedFrames.of(session).with_own_masks()
    frames = tuple(session.frames[i] for i in recorded.keyframes(most))
    if not frames:
        raise InputError(
            f"{session.folder}: --keyframes: expected frames well in view with readings of all outer joints, got none"
        )
    return replace(session, frames=frames)


def alone_task(
    body: Body, config: EstimateConfig, files: FrameFiles, *, rig: Rig, arm: Arm, images: SegmentSettings | None
) -> SessionFrame | None:
    """Estimate a keyframe by itself, as `batch` does: by its masks, or by those that are found in its ``images``.

    None where nothing is found.
    """
    read: Reader = partial(read_frame, files, rig)
    data = read() if images is None else segment_task(body, config, files, rig=rig, settings=images)
    if data is None:
        return None
    result = estimate_frame(replace(data, files=files), body, FrameMethod(arm, config))
    return SessionFrame(files.name, read if images is None else data, result, files.keypoints, files.time)


def _too_few(recorded: RecordedFrames, count: int, least: int) -> str:
    """Return why some keyframes are too few."""
    since = recorded.files[int(recorded.frozen.argmax())].name
    frozen = f" (readings frozen since frame {since})" if recorded.frozen.any() else ""
    return f"{count} frames are well in view and have readings{frozen}, fewer than {least}"


def _begin_chosen(
    recorded: RecordedFrames, frames: Sequence[SessionFrame], work: ArmSetup, least: int
) -> Begun[SessionCalibration | str]:
    """Solve keyframes together that were estimated alone; a text says why that is not possible or not to be used.

    ``least`` is the number of those that are needed.
    """
    if len(frames) < least:
        return Begun.of(_too_few(recorded, len(frames), least))
    begun = _tried(lambda: begin_arm(frames, work))
    if isinstance(begun, str):
        return Begun.of(begun)
    return Begun(lambda outcome: _tried(lambda: _in_digits(begun.finish(outcome)[0].calibration)), begun.arm)


def _tried(solve: Callable[[], T]) -> T | str:
    """Solve a session, or return why it cannot be; an error of a file that is missing or damaged is raised."""
    try:
        return solve()
    except InputError as error:
        if not str(error).startswith(_REFUSED):
            raise
        return str(error).removeprefix(_REFUSED)


def _estimated(
    recorded: RecordedFrames, chosen: Sequence[int], work: ArmSetup, usable: Bool | None, images: SegmentSettings | None
) -> dict[int, SessionFrame]:
    """Estimate keyframes alone, by number: some by a search, the others from where these expect them.

    They are chosen among the ``usable`` (N,). So are those in whose ``images`` masks were found that do not agree with
    most others on where the base is.
    """
    work.progress("estimating keyframes", len(chosen))
    files = recorded.files

    def estimated(numbers: Sequence[int], starts: Mapping[str, Result]) -> dict[int, SessionFrame]:
        tasks = [replace(files[i], start=starts.get(files[i].name)) for i in numbers]
        found = work.run(partial(alone_task, rig=recorded.rig, arm=work.arm, images=images), tasks)
        return {i: frame for i, frame in zip(numbers, found, strict=True) if frame is not None}

    first = [i for i in recorded.keyframes(_SEARCHED, usable) if i in chosen]
    found = estimated(first, {})
    rest = [i for i in chosen if images is not None or i not in first]
    readings = {files[i].name: files[i].readings for i in rest}
    starts = predict_from_first([*found.values()], readings, work) if found else {}
    again = [i for i in rest if i not in first or files[i].name in starts]
    found |= estimated(again, starts)
    return {i: found[i] for i in chosen if i in found}


def _in_digits(calibration: SessionCalibration) -> SessionCalibration | str:
    """Return a calibration in the digits of session.json, by which a recording can be followed again, or its fault."""
    return bad_predictions(calibration) or SessionCalibration.from_dict(calibration.to_dict())


def segment_task(
    body: Body, config: EstimateConfig, files: FrameFiles, *, rig: Rig, settings: SegmentSettings
) -> FrameData | None:
    """Find the masks in the images of a frame with its hints; None where nothing is found, or only a guess.

    Masks that the frame has are kept. In further views the instrument of the first view's prompts is looked for.
    """
    data = read_seen(files, rig)
    if data is None:
        return None
    views: list[SeenView] = []
    for number, view in enumerate(data.views):
        own = replace(view, image=None)
        if view.image is not None and not (view.given and view.mask.any()):
            hints = prompts_in(view, views[0], files.hints, body) if number else files.hints
            mask = segment_view(view, files, hints, body, settings)
            right = mask.confidence >= GUESS and replace(view, mask=mask.mask).shows
            own = replace(own, mask=mask.mask, given=True) if right else own
        views.append(own)
    found = replace(data, views=tuple(views))
    return found if any(view.given and view.shows for view in found.views) else None


def _with_colours(solution: RecordedSolution, found: Mapping[int, FrameData]) -> RecordedSolution | str:
    """Return a calibration with the colours of instrument and surroundings; a text where the images determine none.

    They are learned from masks that were ``found`` where the calibration predicts the instrument.
    """
    recorded, work = solution.recorded, solution.work
    predicted, _ = predict(recorded, solution.calibration, work.instrument.joint_names)
    shown = [i for i in found if recorded.files[i].has_image]
    masks = [{view.name: view.mask for view in found[i].views if view.given} for i in shown]
    reads = [partial(read_seen, recorded.files[i], solution.rig) for i in shown]
    tasks = [(read, predicted.at[i], own) for i, read, own in zip(shown, reads, masks, strict=True)]
    learned = work.run(learn_task, tasks)
    of_views = {view: [of_frame[view] for of_frame in learned if view in of_frame] for view in recorded.rig.names}
    colours = {view: pooled_colours(models) for view, models in of_views.items() if models}
    return replace(solution, colours=colours) if colours else _NO_COLOURS


def begin_solution(
    recorded: RecordedFrames, given: SessionCalibration | None, work: ArmSetup, notice: Notice, *, by_masks: bool
) -> Begun[RecordedSolution | str | None]:
    """Estimate the keyframes of a recording alone and solve them together; a text says why that is not possible.

    A calibration that is ``given`` is used instead. Unless the recording is followed ``by_masks``, masks are found in
    its images, and determine the colours; ``notice`` is called with what is said of a background. Finish it by
    `solved_together` or `solved_alone`. Raises InputError for a file that is wrong.
    """
    if not by_masks:
        return _begin_by_images(recorded, given, work, notice)
    recorded = recorded.with_own_masks()
    if given is not None:
        return Begun.of(RecordedSolution(recorded, given, work))
    chosen = recorded.keyframes()
    if len(chosen) < LEAST_KEYFRAMES:
        return Begun.of(_too_few(recorded, len(chosen), LEAST_KEYFRAMES))
    frames = _estimated(recorded, chosen, work, usable=None, images=None)
    begun = _begin_chosen(recorded, [*frames.values()], work, LEAST_KEYFRAMES)
    return begun.then(lambda solved: solved if isinstance(solved, str) else RecordedSolution(recorded, solved, work))


def _begin_by_images(
    recorded: RecordedFrames, given: SessionCalibration | None, work: ArmSetup, notice: Notice
) -> Begun[RecordedSolution | str | None]:
    """Find masks in images of a recording, by which it is solved as by `begin_solution`, with their colours."""
    usable = np.array([own.has_image or own.has_mask for own in recorded.files])
    chosen = recorded.keyframes(_SEGMENTED, usable)
    if given is None and len(chosen) < LEAST_KEYFRAMES:  # too few to find masks of another tool
        return Begun.of(f"{len(chosen)} images that differ have readings, fewer than {LEAST_KEYFRAMES}")
    images = with_backgrounds(SegmentSettings(), by_view([recorded.files[i] for i in chosen], recorded.rig))
    for text in images.notes:
        notice(text)
    if given is None:
        frames = _estimated(recorded, chosen, work, usable, images)
        found = {i: frame.data for i, frame in frames.items() if isinstance(frame.data, FrameData)}
    else:
        task = partial(segment_task, rig=recorded.rig, settings=images)
        masks = work.run(task, [recorded.files[i] for i in chosen])
        found = {i: own for i, own in zip(chosen, masks, strict=True) if own is not None}
    recorded = recorded.measured(found.items())

    def solution(solved: SessionCalibration | str) -> RecordedSolution | str:
        return solved if isinstance(solved, str) else _with_colours(RecordedSolution(recorded, solved, work), found)

    if given is not None:
        return Begun.of(solution(given))
    alike = replace(work, config=work.config.with_alike_masks())
    keyframes = [frames[i] for i in recorded.keyframes() if i in frames]
    return _begin_chosen(recorded, keyframes, alike, _FEWEST).then(solution)
