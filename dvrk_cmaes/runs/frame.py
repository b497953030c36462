"""One frame, from its files to its result and overlay: what every command does with a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.overlay import draw_failed
from dvrk_cmaes.draw.view_overlays import draw_views
from dvrk_cmaes.estimation import estimate_views
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, readable
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.io.atomic import encoded_image, json_text
from dvrk_cmaes.io.output import LONG, output, remove, write_bytes
from dvrk_cmaes.results.paths import check_output, mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body


@dataclass(frozen=True, eq=False)
class FrameOutcome:
    """A frame's result, and the contents of its other files.

    ``overlay`` is JPEG, None if the frame failed and neither its image nor its mask can be read. ``masks`` are PNGs of
    the masks found in images, by view, "" for the only one.
    """

    result: Result
    overlay: bytes | None
    masks: Mapping[str, bytes] = field(default_factory=dict)


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
    if out is None:
        return solve_frame(files, frame, body, method)[1], ()
    check_output(out, files.name)
    outcome = outcome_of(files, frame, body, method)
    with output(out, command, wait=LONG):
        return outcome.result, write_outcome(out, outcome)


def outcome_of(files: FrameFiles, frame: FrameData, body: Body, method: FrameMethod) -> FrameOutcome:
    """Estimate and draw a frame that was read; arguments and errors as of `solve_frame`."""
    solved, result = solve_frame(files, frame, body, method)
    views = solved.views if method.session is None else method.session.corrected_views(solved.views)
    found = () if solved is frame else [view for view in solved.views if view.given]
    masks = {view.name if len(views) > 1 else "": encoded_image("mask.png", view.mask) for view in found}
    return FrameOutcome(result, encoded_image("overlay.jpg", draw_views(result, views, body)), masks)


def write_outcome(out: Path, outcome: FrameOutcome) -> tuple[Path, ...]:
    """Write a frame's files, the result last, so that a frame with a result has all its files; returns their paths."""
    frame = outcome.result.frame
    masks = {mask_path(out, frame, view): mask for view, mask in outcome.masks.items()}
    for path, mask in masks.items():
        write_bytes(path, mask)
    if outcome.overlay is not None:
        write_bytes(overlay_path(out, frame), outcome.overlay)
    else:
        remove(overlay_path(out, frame))
    write_bytes(result_path(out, frame), json_text(outcome.result.to_dict()).encode())
    return result_path(out, frame), overlay_path(out, frame), *masks


def solve_frame(files: FrameFiles, frame: FrameData, body: Body, method: FrameMethod) -> tuple[FrameData, Result]:
    """Estimate the pose in a frame that was read; in one without a mask, find that first, which is then in the frame.

    Errors as `estimate` and `segment_and_estimate`.
    """
    if any(view.given for view in frame.views):
        return frame, estimate_frame(files, frame, body, method)
    from dvrk_cmaes.estimation.image_frame import segment_and_estimate

    segmented = segment_and_estimate(frame, files, body, method)
    return segmented.data, segmented.result


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
