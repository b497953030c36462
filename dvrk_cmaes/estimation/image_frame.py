"""Frames that have images and no mask: segmentation and pose estimation in alternation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.one_tool import FrameMethod, estimate_views
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.seen_view import SeenView, overlap_of
from dvrk_cmaes.pose.doubts import mask_is_a_guess
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.segment import Segmentation, segment
from dvrk_cmaes.segment.around import segmentation_around
from dvrk_cmaes.segment.prompts import draw_prompts
from dvrk_cmaes.segment.segmentation import GUESS, Hints, SegmentSettings
from dvrk_cmaes.segment.shaft_pairs import prompts_in
from dvrk_cmaes.silhouette import Body

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration


_ITERATIONS = 2  # segmentations after the first
_LEAST_OVERLAP = 0.8  # intersection over union of silhouette and mask, below which the silhouette is no prior


class _FoundMask(NamedTuple):
    """A view with the mask found in its image, how it was found, and the result of the mask if it is known.

    ``result`` is that of this view alone, without jaw tips and session.
    """

    view: SeenView
    segmentation: Segmentation
    result: Result | None


def segment_and_estimate(data: FrameData, body: Body, method: FrameMethod) -> tuple[FrameData, Segmentation, Result]:
    """Find the instrument's masks in the images of a frame's views, and its pose from these masks.

    Returns the frame with these masks, how that of its first view was found, and the result.

    Each image is segmented; with the classic model, the pose is estimated and the image segmented again with the pose's
    silhouette as prior, two times, unless silhouette and mask hardly overlap. A mask by a smooth background, or of a
    learned model, is kept as it is. The result of a frame of one view is doubtful if the mask's confidence is low.

    Parameters
    ----------
    data
        The frame, whose first view has an image. Its prompts hold in that view; in further views the instrument that
        they choose, or the one that is taken of several, is looked for.
    body
        As in `estimate`.
    method
        How the frame is solved.

    Raises
    ------
    InputError
        As `estimate` and `segment`.
    DvrkCmaesError
        Nothing was found that could be the instrument; names the image's file.
    """
    settings, session, files = method.segment or SegmentSettings(), method.session, data.files
    started = perf_counter()

    def solve(views: Sequence[SeenView], session: SessionCalibration | None = None) -> Result:
        own, named = replace(method, session=session), len(views) > 1
        return estimate_views(views, files.readings, body, own, named=named, frame=files.name, time=files.time)

    found: list[_FoundMask] = []
    for view in data.views:
        own = files.hints
        if found:
            own = prompts_in(view, found[0].view, own, body, several=bool(found[0].segmentation.others))
        try:
            found.append(_find_mask(view, body, files, solve, settings, own, method.config.threads))
        except DvrkCmaesError as error:
            raise type(error)(f"{files.others.get(view.name, files).picture}: {error}") from None
    (first, segmentation, result), alone = found[0], len(found) == 1
    data = replace(data, views=tuple(each.view for each in found), notes=(*data.notes, *segmentation.notes))
    seconds = perf_counter() - started
    result = result if alone and first.keypoints is None and session is None else None
    if result is None:
        result = solve(data.views, session)
        seconds += result.seconds
    result = replace(result, warnings=(*data.notes, *result.warnings), seconds=seconds)
    if alone and (guess := mask_is_a_guess(segmentation.confidence, GUESS)):
        result = replace(result, status="doubtful", reasons=(*result.reasons, guess))
    return data, segmentation, result


def segment_view(
    view: SeenView, files: FrameFiles, hints: Hints, body: Body, settings: SegmentSettings, threads: int = 1
) -> Segmentation:
    """Segment the image of a view of a frame; where the frame has a result to start from, as that expects it.

    Parameters
    ----------
    view, files, hints
        The view, which has an image, the files of its frame, and prompts in the view's image.
    body, settings, threads
        The instrument, and how it is looked for.
    """
    assert view.image is not None
    start, names = files.start, body.instrument.joint_names
    return segment(
        view.image,
        **vars(hints),
        model=settings.model,
        weights=settings.weights,
        threads=threads,
        background=settings.backgrounds.get(view.name),
        instrument=body,
        camera=view.camera,
        joints=files.readings,
        expected=None if start is None else posed(start, names).seen_from(view.view_from_camera),
    )


def _find_mask(
    view: SeenView,
    body: Body,
    files: FrameFiles,
    solve: Callable[[Sequence[SeenView]], Result],
    settings: SegmentSettings,
    hints: Hints,
    threads: int,
) -> _FoundMask:
    """Find the mask in the image of a view; a view without an image stays as it is."""
    image = view.image
    if image is None:
        return _FoundMask(view, Segmentation(view.mask), None)
    found = segment_view(view, files, hints, body, settings, threads)
    view = replace(view, mask=found.mask, given=True)
    if not view.shows:
        raise DvrkCmaesError("no instrument found in the image; a mask, a box or a point on the instrument would help")
    result, odds = None, found.odds
    counts, prompts = np.True_ if view.ignore is None else ~view.ignore, draw_prompts(image, hints)
    for _ in range(_ITERATIONS if settings.model == "classic" and found.before != "smooth background" else 0):
        alone = replace(view, view_from_camera=np.eye(4), keypoints=None)
        result = solve([alone])
        if result.camera_from_root is None:
            break
        silhouette = silhouette_of(posed(result, body.instrument.joint_names), alone, body)
        if overlap_of(silhouette & counts, view.mask & counts) < _LEAST_OVERLAP:
            break
        again = segmentation_around(image, silhouette, prompts, colours=odds, local=odds is None)
        if not again.mask.any():
            break
        view, result = replace(view, mask=again.mask), None
        if again.confidence < found.confidence:
            which = found.notes[-1:] if found.others else ()  # the last note names which of several is taken
            found = replace(found, confidence=again.confidence, notes=(*again.notes, *which))
    means = f"by the {settings.model} model" if found.before is None else f"by its {found.before}"
    how = f"mask found in the image {means}, confidence {found.confidence:.2f}"
    found = replace(found, mask=view.mask, notes=(how, *found.notes))
    return _FoundMask(view, found, result)
