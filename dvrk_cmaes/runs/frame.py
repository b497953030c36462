"""One frame, from its files to its result and overlay: what every command does with a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.draw.overlay import draw_failed
from dvrk_cmaes.draw.view_overlays import draw_views
from dvrk_cmaes.estimation import estimate_views
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame, read_frame_image, readable
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.output import LONG, output
from dvrk_cmaes.results.paths import check_output, write_frame
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration


@dataclass(frozen=True, eq=False)
class SolvedFrame:
    """A frame in memory and its result; ``found_masks`` are those found in images, by view, "" for the only one.

    The camera of ``data`` is that of the result: a session's calibration may have changed it.
    """

    data: FrameData
    result: Result
    found_masks: Mapping[str, Bool] = field(default_factory=dict)


def read_any_frame(files: FrameFiles, camera: Camera | Rig) -> FrameData:
    """Read a frame that has a mask, of a rig in at least one view, or only images.

    Errors as `read_frame` and `read_frame_image`.
    """
    return read_frame(files, camera) if files.has_mask else read_frame_image(files, camera)


def run_frame(
    files: FrameFiles, frame: FrameData, body: Body, method: FrameMethod, out: Path | None, command: str = "estimate"
) -> tuple[Result, tuple[Path, ...]]:
    """Estimate the pose in a frame that was read, and write its result and overlay to the folder ``out`` if given.

    Arguments as in `solve_frame`; ``command`` is that which writes.

    Raises
    ------
    InputError
        As `solve_frame`; a name or folder that cannot be written to, in which case nothing is written.
    """
    if out is not None:
        check_output(out, files.name)
    solved = solve_frame(files, frame, body, method)
    if out is None:
        return solved.result, ()
    overlay = draw_views(solved.result, solved.data.views, body)
    with output(out, command, wait=LONG):
        return solved.result, write_frame(out, solved.result, overlay, solved.found_masks)


def solve_frame(files: FrameFiles, frame: FrameData, body: Body, method: FrameMethod) -> SolvedFrame:
    """Estimate the pose in a frame that was read; in a frame without a mask, find the mask first.

    Errors as `estimate` and `segment_and_estimate`.
    """
    if any(view.given for view in frame.views):
        return SolvedFrame(as_calibrated(frame, method.session), estimate_frame(files, frame, body, method))
    from dvrk_cmaes.estimation.image_frame import segment_and_estimate

    segmented = segment_and_estimate(frame, files, body, method)
    alone = len(frame.views) == 1
    masks = {"" if alone else view.name: view.mask for view in segmented.data.views if view.given}
    return SolvedFrame(as_calibrated(segmented.data, method.session), segmented.result, masks)


def as_calibrated(data: FrameData, session: SessionCalibration | None) -> FrameData:
    """Return a frame's data with the camera or rig with which a session was solved."""
    return data if session is None else replace(data, views=session.corrected_views(data.views))


def estimate_frame(files: FrameFiles, data: FrameData, body: Body, method: FrameMethod) -> Result:
    """Estimate the pose in a frame with a mask that was read from its files; errors as `estimate`."""
    return estimate_views(
        data.views,
        files.readings,
        body,
        method,
        named=len(data.views) > 1,
        start=files.start,
        frame=files.name,
        time=files.time,
        warnings=data.notes,
    )


def draw_failed_frame(result: Result, files: FrameFiles) -> NDArray[np.uint8] | None:
    """Draw a frame without a pose: its image or else its mask, (H, W, 3) BGR; None if neither can be read."""
    pictures = (readable(partial(read_image, path)) for path in (files.image, files.mask) if path is not None)
    return next((draw_failed(result, picture) for picture in pictures if picture is not None), None)
