"""One frame, from its files to its result and overlay: what every command does with a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.frame_layers import frame_layers
from dvrk_cmaes.draw.overlay import draw_failed, draw_overlay
from dvrk_cmaes.draw.view_overlays import DrawnView, draw_views
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import better_of, estimate
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, FrameImage, read_frame, read_frame_image
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.frames.view_frames import read_views
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.layers import FrameLayers
from dvrk_cmaes.results.paths import check_output, write_frame
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings
from dvrk_cmaes.silhouette import Body


@dataclass(frozen=True, eq=False)
class SolvedFrame:
    """A frame in memory and its result; ``found_mask`` tells whether the mask was found in the image.

    The camera of ``data`` is that of the result: a session's calibration may have changed it.
    """

    data: FrameData
    result: Result
    found_mask: bool = False


@dataclass(frozen=True, eq=False)
class FrameRun:
    """A frame's result, and the files written: JSON, overlay and, if it was found in the image, the mask."""

    result: Result
    written: tuple[Path, ...]


def read_any_frame(files: FrameFiles, camera: Camera | Rig) -> FrameData | FrameImage:
    """Read a frame that has a mask, or only an image; of a rig, all of its views.

    Errors as `read_frame`, `read_frame_image` and `read_views`.
    """
    if isinstance(camera, Rig):
        return read_views(files, camera)
    if files.mask is None and files.image is not None:
        return read_frame_image(files, camera)
    return read_frame(files, camera)


def read_masked_frame(files: FrameFiles, camera: Camera | Rig) -> FrameData:
    """Read a frame that has a mask, of a rig in at least one view; errors as `read_any_frame`."""
    frame = read_any_frame(files, camera)
    if isinstance(frame, FrameImage):
        raise InputError(f"frame {files.name}: expected a mask, got {frame.path}")
    return frame


def read_without_image(files: FrameFiles, camera: Camera | Rig) -> FrameData:
    """Read a frame that has a mask as `read_masked_frame` does, without the images of its views."""
    others = {name: replace(one, image=None) for name, one in files.others.items()}
    return read_masked_frame(replace(files, image=None, others=others), camera)


def run_frame(
    files: FrameFiles,
    frame: FrameData | FrameImage,
    body: Body,
    *,
    arm: Arm,
    config: EstimateConfig,
    out: Path | None,
    session: SessionCalibration | None = None,
    settings: SegmentSettings | None = None,
    hints: Hints | None = None,
) -> FrameRun:
    """Estimate the pose in a frame that was read, and write its result and overlay to the folder ``out`` if given.

    Arguments as in `solve_frame`.

    Raises
    ------
    InputError
        As `solve_frame`; a name or folder that cannot be written to, in which case nothing is written.
    """
    if out is not None:
        check_output(out, files.name)
    solved = solve_frame(files, frame, body, arm=arm, config=config, session=session, settings=settings, hints=hints)
    if out is None:
        return FrameRun(solved.result, ())
    overlay = draw_frame(solved.result, files, solved.data, body)
    found_mask = solved.data.mask if solved.found_mask else None
    return FrameRun(solved.result, write_frame(out, solved.result, overlay, found_mask))


def solve_frame(
    files: FrameFiles,
    frame: FrameData | FrameImage,
    body: Body,
    *,
    arm: Arm,
    config: EstimateConfig,
    session: SessionCalibration | None = None,
    settings: SegmentSettings | None = None,
    hints: Hints | None = None,
) -> SolvedFrame:
    """Estimate the pose in a frame that was read; in a frame without a mask, find the mask first.

    ``settings`` and ``hints`` say how, as in `segment_and_estimate`. Errors as `estimate` and `segment_and_estimate`.
    """
    if isinstance(frame, FrameImage) and frame.rig is not None:
        frame = _with_masks_of_views(frame, files, body, config=config, settings=settings, hints=hints)
    if isinstance(frame, FrameData):
        result = estimate_frame(files, frame, body, arm=arm, config=config, session=session)
        return SolvedFrame(_as_calibrated(frame, session), result)
    from dvrk_cmaes.runs.image_frame import segment_and_estimate

    segmented = segment_and_estimate(
        frame,
        files.name,
        files.readings,
        body,
        keypoints=files.keypoints,
        arm=arm,
        time=files.time,
        session=session,
        config=config,
        settings=settings,
        hints=hints,
    )
    return SolvedFrame(_as_calibrated(segmented.data, session), segmented.result, found_mask=True)


def _with_masks_of_views(
    frame: FrameImage,
    files: FrameFiles,
    body: Body,
    *,
    config: EstimateConfig,
    settings: SegmentSettings | None,
    hints: Hints | None,
) -> FrameData:
    """Find the masks in the images of all views, each by itself; ``hints`` are those of the main view."""
    from dvrk_cmaes.runs.image_frame import segment_and_estimate

    assert frame.rig is not None
    found = {}
    for name, image in {frame.rig.names[0]: replace(frame, rig=None, others={}), **frame.others}.items():
        own = hints if name == frame.rig.names[0] else None
        segmented = segment_and_estimate(
            image, files.name, files.readings, body, config=config, settings=settings, hints=own
        )
        found[name] = segmented.data
    main = found.pop(frame.rig.names[0])
    return replace(main, rig=frame.rig, others=found)


def _as_calibrated(data: FrameData, session: SessionCalibration | None) -> FrameData:
    """Return a frame's data with the camera with which a session was solved."""
    return data if session is None else replace(data, camera=session.corrected(data.camera))


def estimate_frame(
    files: FrameFiles,
    data: FrameData,
    body: Body,
    *,
    arm: Arm,
    config: EstimateConfig,
    session: SessionCalibration | None = None,
) -> Result:
    """Estimate the pose in a frame with a mask that was read from its files; errors as `estimate`.

    Of a frame that starts from an earlier result, the better one of the two is returned, as by `better_of`.
    """
    masks: Any = data.mask
    ignore: Any = data.ignore
    keypoints: Any = files.keypoints
    if data.rig is not None:
        masks = {name: one.mask for name, one in data.of_views.items()}
        ignore = {name: one.ignore for name, one in data.of_views.items()}
        keypoints = {data.rig.names[0]: files.keypoints}
    result = estimate(
        masks,
        data.camera if data.rig is None else data.rig,
        files.readings,
        body,
        ignore=ignore,
        keypoints=keypoints,
        arm=arm,
        session=session,
        start=files.start,
        frame=files.name,
        time=files.time,
        config=config,
        warnings=data.notes,
    )
    return result if files.start is None else better_of(files.start, result)


def draw_frame(
    result: Result, files: FrameFiles, data: FrameData, body: Body, evidence: Evidence | None = None
) -> NDArray[np.uint8]:
    """Draw a frame's result over its image, or over its mask where it has no image; returns (H, W, 3) BGR.

    The views of a rig are drawn side by side. ``evidence`` is that of the mask, for a frame without a rig, where known.
    """
    if data.rig is not None:
        return draw_views(result, seen_in(data), body)
    return draw_overlay(
        result,
        data.mask,
        data.camera,
        body,
        image=data.image,
        ignore=data.ignore,
        keypoints=files.keypoints,
        evidence=evidence,
    )


def seen_in(data: FrameData) -> list[DrawnView]:
    """Return the views of a frame that have a mask, to be drawn; the only view of a frame without a rig."""
    if data.rig is None:
        return [DrawnView("", data.mask, data.camera, np.eye(4), data.image, data.ignore)]
    of_views = data.of_views
    return [
        DrawnView(view.name, of_views[view.name].mask, view.camera, view.view_from_camera, of_views[view.name].image)
        for view in data.rig.views
        if view.name in of_views and of_views[view.name].mask.any()
    ]


def layers_of_frame(result: Result, data: FrameData, body: Body) -> FrameLayers:
    """Return the layers of a frame's drawing; of a rig, those of its first view."""
    return frame_layers(result, data.mask, data.camera, body, image=data.image)


def draw_failed_frame(result: Result, files: FrameFiles) -> NDArray[np.uint8] | None:
    """Draw a frame without a pose: its image or else its mask, (H, W, 3) BGR; None if neither can be read."""
    for path in (files.image, files.mask):
        if path is not None:
            try:
                return draw_failed(result, read_image(path))
            except InputError:
                continue
    return None
