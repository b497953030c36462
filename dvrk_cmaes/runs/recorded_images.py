"""A recording without masks: masks found in some of its images, its keyframes among them, and the fits of all images.

The masks of the keyframes are found in each image by the colours of what moves in the recording. Those that show
something else than the instrument do not agree with the others, and are left out as the keyframes are solved together.
From the keyframes' poses the colours of instrument and surroundings are learned, by which the masks of all images are
found around what is expected of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.calibrate import SolvedSession
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import Run
from dvrk_cmaes.calibration.masks_again import PackedMask
from dvrk_cmaes.calibration.prediction import Prediction
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, image_path, read_frame, read_frame_image
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.pose.terms.expected import Expected
from dvrk_cmaes.runs.recorded import BLOCK, predict
from dvrk_cmaes.runs.recorded_keyframes import Keyframe, RecordedFrames, solve_together
from dvrk_cmaes.runs.worker import hints_of
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.segment.moving_colours import MOST, reduced
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings
from dvrk_cmaes.segment.shaft_pairs import prompt_in
from dvrk_cmaes.segment.silhouette_prior import segment_first
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.histogram_ratio import ColourModel
from dvrk_cmaes.track.image_frames import (
    AroundTask,
    ImageBlockTask,
    LearnTask,
    around_task,
    fit_image_block,
    learn_task,
    with_outside,
)
from dvrk_cmaes.track.image_masks import mask_by_colours, moving_colours, pooled_colours
from dvrk_cmaes.track.keyframes import LEAST_KEYFRAMES, MaskShape, choose_keyframes
from dvrk_cmaes.track.recorded_frames import FittedFrame, PredictedFrame

Float64 = NDArray[np.float64]

_SEGMENTED: Final = 60  # images, at most, that are segmented by themselves
_FEWEST: Final = 6  # keyframes whose masks were found, with which a recording is solved
_ENOUGH: Final = 20  # that agree; of fewer, masks are found again in the other images, and solved again
_MORE: Final = 1.3  # times as many keyframes as agreed, from which on they are solved again
_NO_COLOURS: Final = "no image shows enough of the instrument where it is expected"
_KEYFRAMES: Final = 40  # of these, at most, that are solved together


@dataclass(frozen=True, eq=False)
class FoundFrame:
    """A frame whose masks were found in its images: its views, without arrays, and the arrays of each, packed."""

    views: tuple[SeenView, ...]
    masks: tuple[PackedMask, ...]
    ignored: tuple[PackedMask | None, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, data: FrameData) -> FoundFrame:
        """Pack a frame."""
        nothing = np.zeros((0, 0), np.bool_)
        return cls(
            tuple(replace(view, mask=nothing, ignore=None, image=None) for view in data.views),
            tuple(PackedMask.of(view.mask) for view in data.views),
            tuple(None if view.ignore is None else PackedMask.of(view.ignore) for view in data.views),
            data.notes,
        )

    def restored(self) -> FrameData:
        """Return the frame's data, without images."""
        arrays = zip(self.views, self.masks, self.ignored, strict=True)
        views = (
            replace(view, mask=mask.restored(), ignore=None if ignored is None else ignored.restored())
            for view, mask, ignored in arrays
        )
        return FrameData(tuple(views), self.notes)


@dataclass(frozen=True, eq=False)
class SegmentTask:
    """Arguments of `segment_task`; ``colours``, by view, are those of what moves in the recording."""

    files: FrameFiles
    rig: Rig
    hints: Hints
    colours: Mapping[str, ColourModel]


@dataclass(frozen=True, eq=False)
class ImageSolution:
    """The calibration of a recording's keyframes, and the colours of instrument and surroundings, by view."""

    calibration: SessionCalibration
    colours: Mapping[str, ColourModel]


def segment_task(body: Body, config: EstimateConfig, task: SegmentTask) -> FoundFrame | None:
    """Find the masks in the images of a frame; None where nothing is found, or only a guess.

    Masks that the frame has are kept. In further views the instrument of the first view's prompts is looked for.
    """
    data = with_outside(read_seen(task.files, task.rig))
    views: list[SeenView] = []
    for number, view in enumerate(data.views):
        hints = task.hints
        if number:  # the prompts are pixels of the first view
            chosen = hints != Hints() and views[0].given
            hints = prompt_in(view, views[0].mask, views[0], body) if chosen else Hints()
        if view.image is None or (view.given and view.mask.any()):
            views.append(replace(view, image=None))
            continue
        mask = _first_mask(view, hints, task.colours.get(view.name))
        views.append(view if mask is None else replace(view, mask=mask, given=True))
    found = replace(data, views=tuple(views))
    return FoundFrame.of(found) if any(view.given and view.shows for view in found.views) else None


def _first_mask(view: SeenView, hints: Hints, colours: ColourModel | None) -> NDArray[np.bool_] | None:
    """Find the mask of a view in its image; None where nothing is found, or only a guess.

    It is found by the colours of what moves in the recording; by those of this image alone where that gives a guess,
    nothing moves, or there are prompts.
    """
    assert view.image is not None
    if colours is not None and hints == Hints():
        found = mask_by_colours(view.image, colours, Prompts().with_outside(outside_view(view.image)))
        if found.confidence >= GUESS:
            return found.mask
    try:
        found = segment_first(
            view.image, view.ignore, settings=SegmentSettings(), hints=hints, threads=1, view=view.name
        )
    except InputError:
        raise
    except DvrkCmaesError:
        return None
    return found.mask if found.confidence >= GUESS else None


def _moving_colours(recorded: RecordedFrames, chosen: Sequence[int]) -> dict[str, ColourModel]:
    """Return the colours of what moves in the images of each view, where anything does."""
    step = max(len(chosen) // MOST, 1)
    images: dict[str, list[NDArray[np.uint8]]] = {name: [] for name in recorded.rig.names}
    for i in chosen[::step][:MOST]:
        if recorded.files[i].has_image and not recorded.files[i].has_mask:
            for view in read_frame_image(recorded.files[i], recorded.rig).views:
                if view.image is not None:
                    images[view.name].append(reduced(view.image))
    found = {name: moving_colours(of_view) for name, of_view in images.items()}
    return {name: colours for name, colours in found.items() if colours is not None}


def read_seen(files: FrameFiles, rig: Rig) -> FrameData:
    """Read a frame by its masks, where it has any, or else its images; InputError for a file that is wrong."""
    return read_frame(files, rig, blank=True) if files.has_mask else read_frame_image(files, rig)


def solve_images(
    recorded: RecordedFrames,
    given: SessionCalibration | None,
    hints: Hints,
    body: Body,
    arm: Arm,
    config: EstimateConfig,
    run: Run[Any, Any],
    progress: Callable[[str, int], None],
) -> tuple[RecordedFrames, ImageSolution | str]:
    """Find masks in images of a recording, and solve those that are well in view together; or say why not.

    With a calibration that is ``given``, the masks only tell the colours. Where few keyframes agree, masks are found in
    the other images around what they expect, and all are solved again. ``hints`` hold for the first frame. Also returns
    the frames with what was measured of the masks. Raises InputError for a file that is wrong.
    """
    files, times, names, readings = recorded.files, recorded.times, recorded.names, recorded.readings
    there = np.array([own.has_image or own.has_mask for own in files]) & recorded.trusted
    chosen = choose_keyframes(there, times, names, readings, _SEGMENTED)
    if given is None and len(chosen) < LEAST_KEYFRAMES:  # too few to tell masks of another tool from the right ones
        return recorded, f"{len(chosen)} images that differ have readings, fewer than {LEAST_KEYFRAMES}"
    progress("finding masks", len(chosen))
    moving = _moving_colours(recorded, chosen)
    tasks = [
        SegmentTask(files[i], recorded.rig, _hints(files[i], hints if i == 0 else Hints()), moving) for i in chosen
    ]
    found: dict[int, FoundFrame | None] = dict(zip(chosen, run(segment_task, tasks), strict=True))
    recorded = _measured(recorded, found)
    if given is not None:
        tasks_of_colours = _predicted_colours(recorded, given, found, body)
        colours = _pooled(recorded.rig, run(learn_task, tasks_of_colours))
        return recorded, ImageSolution(given, colours) if colours else _NO_COLOURS
    solved = solve_together(recorded, _keyframes(recorded, found), body, arm, config, run, progress, _FEWEST)
    if isinstance(solved, str):
        return recorded, solved
    solution = _solution(recorded, solved, body, run)
    few = len(solved.calibration.frames) < _ENOUGH and len(recorded.rig.views) == 1
    if isinstance(solution, ImageSolution) and few:
        more = _found_around(recorded, solution, found, body, run)
        more_measured = _measured(recorded, more)
        keyframes = _keyframes(more_measured, more)
        if len(keyframes) > _MORE * len(solved.calibration.frames):
            again = solve_together(more_measured, keyframes, body, arm, config, run, progress, _FEWEST)
            if not isinstance(again, str) and len(again.calibration.frames) > len(solved.calibration.frames):
                return more_measured, _solution(more_measured, again, body, run)
    return recorded, solution


def _keyframes(recorded: RecordedFrames, found: Mapping[int, FoundFrame | None]) -> list[Keyframe]:
    """Choose keyframes among the frames in which masks were found."""
    return [
        Keyframe(i, recorded.files[i].changed(image=None), one.restored)
        for i in recorded.keyframes(_KEYFRAMES)
        if (one := found[i]) is not None
    ]


def _solution(recorded: RecordedFrames, solved: SolvedSession, body: Body, run: Run[Any, Any]) -> ImageSolution | str:
    """Return the calibration of keyframes with the colours that they tell; a text where they tell none."""
    colours = _pooled(recorded.rig, run(learn_task, _keyframes_colours(recorded, solved, body)))
    return ImageSolution(solved.calibration, colours) if colours else _NO_COLOURS


def _found_around(
    recorded: RecordedFrames,
    solution: ImageSolution,
    found: Mapping[int, FoundFrame | None],
    body: Body,
    run: Run[Any, Any],
) -> dict[int, FoundFrame | None]:
    """Find masks where few keyframes expect the instrument; those of the frames that agree are kept."""
    session = solution.calibration
    predicted, used = predict(recorded, session, body.instrument.joint_names)[0], set(session.frames)
    information = np.linalg.inv(predicted.spread)
    others = [i for i in found if recorded.files[i].name not in used]
    tasks = [
        AroundTask(
            PredictedFrame(
                recorded.files[i].name,
                partial(_read_images, recorded.files[i], recorded.rig, session),
                Expected(predicted.at[i], information[i]),
            ),
            solution.colours,
        )
        for i in others
    ]
    around: Sequence[FrameData | None] = run(around_task, tasks)
    again = {i: None if data is None else FoundFrame.of(data) for i, data in zip(others, around, strict=True)}
    return {i: again.get(i, one) for i, one in found.items()}


def _hints(files: FrameFiles, first: Hints) -> Hints:
    """Return the prompts of a frame; those of the first one are given."""
    return first if first != Hints() else hints_of(files) or Hints()


def _measured(recorded: RecordedFrames, found: Mapping[int, FoundFrame | None]) -> RecordedFrames:
    """Measure the masks that were found."""
    count = len(recorded.files)
    shapes, centres = [MaskShape(0.0, 1.0)] * count, np.full((count, 2), np.nan)
    for i, one in found.items():
        mask = None if one is None else one.masks[0].restored()
        if mask is not None and mask.any():
            shapes[i] = MaskShape.of(mask)
            rows, columns = np.nonzero(mask)
            centres[i] = columns.mean(), rows.mean()
    return recorded.measured(shapes, centres)


def _keyframes_colours(recorded: RecordedFrames, solved: SolvedSession, body: Body) -> list[LearnTask]:
    """Return the tasks that learn colours from the keyframes that agree, at their poses."""
    used, tasks = set(solved.calibration.frames), []
    for own in recorded.files:
        if own.name in used and own.has_image:
            result = solved.results[own.name]
            assert result.camera_from_root is not None
            joints = np.array([result.joints[name] for name in body.instrument.joint_names])
            reader = partial(_read_images, own, recorded.rig, solved.calibration)
            tasks.append(LearnTask(reader, Posed(result.camera_from_root, joints)))
    return tasks


def _predicted_colours(
    recorded: RecordedFrames, given: SessionCalibration, found: Mapping[int, FoundFrame | None], body: Body
) -> list[LearnTask]:
    """Return the tasks that learn colours from masks where a calibration predicts the instrument."""
    predicted, tasks = predict(recorded, given, body.instrument.joint_names)[0], []
    for i, one in found.items():
        own = recorded.files[i]
        if one is not None and own.has_image:
            masks = {view.name: mask for view, mask in zip(one.views, one.masks, strict=True) if view.given}
            tasks.append(LearnTask(partial(_read_images, own, recorded.rig, given), predicted.at[i], masks))
    return tasks


def _pooled(rig: Rig, found: Sequence[Mapping[str, ColourModel]]) -> dict[str, ColourModel]:
    """Return the colours of each view that was learned in any frame."""
    of_views = {view: [of_frame[view] for of_frame in found if view in of_frame] for view in rig.names}
    return {view: pooled_colours(models) for view, models in of_views.items() if models}


def _read_images(files: FrameFiles, rig: Rig, session: SessionCalibration) -> FrameData:
    """Read a frame's images, and its masks if it has any, with the camera or rig of the calibration."""
    data = read_seen(files, rig)
    return replace(data, views=session.corrected_views(data.views))


def _read_for_fit(files: FrameFiles, rig: Rig, session: SessionCalibration) -> FrameData | None:
    """Read a frame as `_read_images`; None if it has neither mask nor image."""
    if files.problem is not None:
        raise InputError(files.problem)
    if not files.has_mask and image_path(files) is None:
        return None
    return _read_images(files, rig, session)


def fit_images(
    recorded: RecordedFrames, solution: ImageSolution, predicted: Prediction, run: Run[Any, Any]
) -> list[FittedFrame | None]:
    """Fit every frame by its images with the prediction as its prior."""
    session = solution.calibration
    information = np.linalg.inv(predicted.spread)
    frames = [
        PredictedFrame(
            own.name,
            partial(_read_for_fit, own, recorded.rig, session),
            Expected(predicted.at[i], information[i]),
        )
        for i, own in enumerate(recorded.files)
    ]
    blocks: Sequence[ImageBlockTask] = [
        ImageBlockTask(tuple(frames[k : k + BLOCK]), session.masks, solution.colours)
        for k in range(0, len(frames), BLOCK)
    ]
    return [fitted for block in run(fit_image_block, blocks) for fitted in block]
