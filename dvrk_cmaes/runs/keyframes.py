"""The calibration by which a recording is followed: solved from keyframes, or the reason that there is none.

Where frames have no masks, those of the keyframes are found in each image by itself. Masks that show something else
than the instrument do not agree with the others, and are left out as the keyframes are solved together.
From the keyframes' poses the colours of instrument and surroundings are learned, by which the masks of all images are
found around what is expected of them.
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
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.agreement import start_at
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.runs.recording import RecordedFrames, RecordedSolution, predict, read_seen
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.segmentation import GUESS
from dvrk_cmaes.segment.shaft_pairs import prompts_in
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.frame_fits import learn_task, with_outside
from dvrk_cmaes.track.image_masks import pooled_colours
from dvrk_cmaes.track.keyframes import LEAST_KEYFRAMES

_REFUSED: Final = "session: "  # begins what `calibrate_session` says of a session that it cannot solve
_SEGMENTED: Final = 60  # images, at most, that are segmented by themselves
_FEWEST: Final = 6  # keyframes whose masks were found, with which a recording is solved
_NO_COLOURS: Final = "no image shows enough of the instrument where it is expected"
_SEARCHED: Final = 16  # keyframes that are searched for; the others start from where these expect them
_FOUND_KEYFRAMES: Final = 40  # keyframes, at most, whose masks were found
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


def alone_task(body: Body, config: EstimateConfig, keyframe: tuple[FrameFiles, Reader], *, arm: Arm) -> Result:
    """Estimate a keyframe by itself, as `batch` does."""
    files, read = keyframe
    return estimate_frame(replace(read(), files=files), body, FrameMethod(arm, config))


def _begin_chosen(
    recorded: RecordedFrames, keyframes: Mapping[int, Reader], work: ArmSetup, least: int
) -> Begun[SessionCalibration | str]:
    """Estimate keyframes alone and solve them together; a text says why that is not possible or not to be used.

    ``keyframes`` are what reads them, by number, ``least`` is the number of those that are needed.
    """
    if len(keyframes) < least:
        since = recorded.files[int(recorded.frozen.argmax())].name
        frozen = f" (readings frozen since frame {since})" if recorded.frozen.any() else ""
        return Begun.of(f"{len(keyframes)} frames are well in view and have readings{frozen}, fewer than {least}")
    work.progress("estimating keyframes", len(keyframes))
    frames = _estimated(recorded, keyframes, work)
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


def _estimated(recorded: RecordedFrames, keyframes: Mapping[int, Reader], work: ArmSetup) -> list[SessionFrame]:
    """Estimate keyframes alone: some by a search, the others from where these expect them."""
    files, names = recorded.files, work.instrument.joint_names

    def estimated(numbers: Sequence[int], starts: Mapping[str, Result]) -> list[SessionFrame]:
        tasks = [(replace(files[i], start=starts.get(files[i].name)), keyframes[i]) for i in numbers]
        results = work.run(partial(alone_task, arm=work.arm), tasks)
        return [
            SessionFrame(own.name, read, result, own.keypoints, own.time)
            for (own, read), result in zip(tasks, results, strict=True)
        ]

    searched = [i for i in recorded.keyframes(_SEARCHED) if i in keyframes]
    rest = [i for i in keyframes if i not in searched]
    first = estimated(searched, {})
    expected = predict_from_first(first, {files[i].name: files[i].readings for i in rest}, work)
    starts = {name: start_at(first[0].result, at, names) for name, at in expected.items()}
    found = dict(zip((*searched, *rest), (*first, *estimated(rest, starts)), strict=True))
    return [found[i] for i in keyframes]


def _in_digits(calibration: SessionCalibration) -> SessionCalibration | str:
    """Return a calibration in the digits of session.json, by which a recording can be followed again, or its fault."""
    return bad_predictions(calibration) or SessionCalibration.from_dict(calibration.to_dict())


def segment_task(body: Body, config: EstimateConfig, files: FrameFiles, *, rig: Rig) -> FrameData | None:
    """Find the masks in the images of a frame with its hints; None where nothing is found, or only a guess.

    Masks that the frame has are kept. In further views the instrument of the first view's prompts is looked for.
    """
    data = read_seen(files, rig)
    if data is None:
        return None
    data = with_outside(data)
    views: list[SeenView] = []
    for number, view in enumerate(data.views):
        own = replace(view, image=None)
        if view.image is not None and not (view.given and view.mask.any()):
            hints = prompts_in(view, views[0], files.hints, body) if number else files.hints
            mask = segment(view.image, **vars(hints), threads=1)
            right = mask.confidence >= GUESS and replace(view, mask=mask.mask).shows
            own = replace(own, mask=mask.mask, given=True) if right else own
        views.append(own)
    found = replace(data, views=tuple(views))
    return found if any(view.given and view.shows for view in found.views) else None


def _segmented(recorded: RecordedFrames, chosen: Sequence[int], work: ArmSetup) -> dict[int, FrameData]:
    """Find the masks in images by number of the frame, of those in which the instrument is found."""
    work.progress("finding masks", len(chosen))
    found = work.run(partial(segment_task, rig=recorded.rig), [recorded.files[i] for i in chosen])
    return {i: one for i, one in zip(chosen, found, strict=True) if one is not None}


def _with_colours(solution: RecordedSolution, found: Mapping[int, FrameData]) -> RecordedSolution | str:
    """Return a calibration with the colours of instrument and surroundings; a text where the images determine none.

    They are learned from masks that were ``found`` where the calibration predicts the instrument.
    """
    recorded, work = solution.recorded, solution.work
    predicted, _ = predict(recorded, solution.calibration, work.instrument.joint_names)
    tasks = [
        (
            partial(read_seen, recorded.files[i], solution.rig),
            predicted.at[i],
            {view.name: view.mask for view in one.views if view.given},
        )
        for i, one in found.items()
        if recorded.files[i].has_image
    ]
    learned = work.run(learn_task, tasks)
    of_views = {view: [of_frame[view] for of_frame in learned if view in of_frame] for view in recorded.rig.names}
    colours = {view: pooled_colours(models) for view, models in of_views.items() if models}
    return replace(solution, colours=colours) if colours else _NO_COLOURS


def begin_solution(
    recorded: RecordedFrames, given: SessionCalibration | None, work: ArmSetup, *, by_masks: bool
) -> Begun[RecordedSolution | str | None]:
    """Estimate the keyframes of a recording alone and solve them together; a text says why that is not possible.

    A calibration that is ``given`` is used instead. Unless the recording is followed ``by_masks``, masks are found in
    its images, and determine the colours. Finish it by `solved_together` or `solved_alone`. Raises InputError for a
    file that is wrong.
    """
    if by_masks:
        recorded, found, least = recorded.with_own_masks(), None, LEAST_KEYFRAMES
        keyframes = {i: partial(read_frame, recorded.files[i], recorded.rig) for i in recorded.keyframes()}
    else:
        chosen = recorded.keyframes(_SEGMENTED, np.array([own.has_image or own.has_mask for own in recorded.files]))
        if given is None and len(chosen) < LEAST_KEYFRAMES:  # too few to find masks of another tool
            return Begun.of(f"{len(chosen)} images that differ have readings, fewer than {LEAST_KEYFRAMES}")
        found, least = _segmented(recorded, chosen, work), _FEWEST
        recorded = recorded.measured(found.items())
        keyframes = {i: partial(replace, found[i]) for i in recorded.keyframes(_FOUND_KEYFRAMES)}

    def solution(solved: SessionCalibration | str) -> RecordedSolution | str:
        if isinstance(solved, str):
            return solved
        own = RecordedSolution(recorded, solved, work)
        return own if found is None else _with_colours(own, found)

    if given is not None:
        return Begun.of(solution(given))
    config = work.config if found is None else work.config.with_alike_masks()
    return _begin_chosen(recorded, keyframes, replace(work, config=config), least).then(solution)
