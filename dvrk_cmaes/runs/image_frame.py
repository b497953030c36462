"""Frames that have an image and no mask: segmentation and pose estimation in alternation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import FrameData, FrameImage
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.segment import Segmentation
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.segment.field_of_view import outside_view
from dvrk_cmaes.segment.mask_or_pose import attribute_doubt
from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings
from dvrk_cmaes.segment.silhouette_prior import segment_again, segment_first
from dvrk_cmaes.silhouette import Body, Renderer

Bool = NDArray[np.bool_]

_ITERATIONS = 2  # segmentations after the first


@dataclass(frozen=True, eq=False)
class SegmentedFrame:
    """A frame whose mask was found in its image, how it was found, and the result of the pose estimate."""

    data: FrameData
    segmentation: Segmentation
    result: Result


def segment_and_estimate(
    frame: FrameImage,
    name: str,
    readings: Mapping[str, float],
    body: Body,
    *,
    keypoints: ArrayLike | None = None,
    arm: Arm = "classic",
    time: float | None = None,
    session: SessionCalibration | None = None,
    config: EstimateConfig | None = None,
    settings: SegmentSettings | None = None,
    hints: Hints | None = None,
) -> SegmentedFrame:
    """Find the instrument's mask in an image, and its pose from that mask.

    The image is segmented; with the classic model, the pose is estimated and the image segmented again with the pose's
    silhouette as prior, up to two times. A learned model's mask is kept as it is. The result is doubtful if the mask's
    confidence is low; a doubtful result states whether the mask or the pose is likely to be wrong.

    Parameters
    ----------
    frame
        The image and its camera.
    name
        The frame's name.
    readings, body, keypoints, arm, time, session, config
        As in `estimate`.
    settings
        The model that segments the image.
    hints
        Prompts: a box, points on the instrument and points beside it.

    Raises
    ------
    InputError
        As `estimate` and `segment`.
    DvrkCmaesError
        Nothing was found that could be the instrument; names the image's file.
    """
    settings, hints = settings or SegmentSettings(), hints or Hints()
    config = config or EstimateConfig()
    outside = outside_view(frame.image)
    if outside.any():
        frame = replace(
            frame,
            ignore=outside if frame.ignore is None else frame.ignore | outside,
            notes=(*frame.notes, "the image is a round picture in black: what is outside of it is ignored"),
        )
    started = perf_counter()

    solve = partial(
        estimate,
        camera=frame.camera,
        joints=readings,
        instrument=body,
        ignore=frame.ignore,
        arm=arm,
        frame=name,
        time=time,
        config=config,
    )
    result: Result | None = None  # of the last mask, without keypoints and session
    try:
        found = segment_first(frame.image, frame.ignore, settings=settings, hints=hints, threads=config.threads)
        for _ in range(_ITERATIONS if settings.model == "classic" else 0):
            result = solve(found.mask)
            silhouette = silhouette_of(result, frame.camera, body)
            again = segment_again(frame.image, silhouette, found.mask, frame.ignore, hints=hints, outside=outside)
            if again is None:
                break
            found, result = again, None
    except DvrkCmaesError as error:
        raise type(error)(f"{frame.path}: {error}") from None
    how = f"mask found in the image by the {settings.model} model, confidence {found.confidence:.2f}"
    found = replace(found, notes=(how, *found.notes))
    data = frame.with_mask(found.mask, found.notes)
    seconds = perf_counter() - started
    if result is None or keypoints is not None or session is not None:
        result = solve(found.mask, keypoints=keypoints, session=session)
        seconds += result.seconds
    result = replace(result, warnings=(*data.notes, *result.warnings), seconds=seconds)
    seen = data if session is None else replace(data, camera=session.corrected(data.camera))
    return SegmentedFrame(data, found, _with_doubts(result, seen, frame.image, found, body))


def _with_doubts(result: Result, data: FrameData, image: NDArray[np.uint8], found: Segmentation, body: Body) -> Result:
    """Add to a result the doubts that follow from how its mask was found."""
    reasons = result.reasons
    if found.confidence < GUESS:
        reasons = (*reasons, f"mask is a guess: confidence {found.confidence:.2f}, expected at least {GUESS}")
    if not reasons:
        return result
    silhouette = silhouette_of(result, data.camera, body)
    reasons = (*reasons, f"mask or pose: {attribute_doubt(image, found, silhouette, data.ignore)}")
    return replace(result, status="doubtful", reasons=reasons)


def silhouette_of(result: Result, camera: Camera, body: Body) -> Bool:
    """Return the silhouette (H, W) of a result's pose; empty where it has none."""
    if result.camera_from_root is None:
        return np.zeros((camera.height, camera.width), np.bool_)
    joints = np.array([result.joints[name] for name in body.instrument.joint_names])
    return np.asarray(Renderer(body, camera, threads=1).masks(result.camera_from_root[None], joints[None])[0])
