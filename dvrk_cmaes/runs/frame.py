"""One frame of an arm, from its files to its result and overlay: what every command does with a frame."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.overlay import draw_failed
from dvrk_cmaes.draw.view_overlays import draw_views
from dvrk_cmaes.errors import DvrkCmaesError, internal_error
from dvrk_cmaes.estimation import estimate_views
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame, readable
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.frames.truth import SessionTruth
from dvrk_cmaes.io.json_file import encoded_image, json_text
from dvrk_cmaes.io.output import LONG, output, remove, write_bytes
from dvrk_cmaes.results.folder import check_output, mask_path, overlay_path, result_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.pool import limit_library_threads, packed, unpacked
from dvrk_cmaes.silhouette import Body


@dataclass(frozen=True, eq=False)
class ArmInSession:
    """An arm of a session: the session as it sees it, its instrument, and how its frames are solved."""

    session: Session
    body: Body
    method: FrameMethod

    def with_config(self, config: EstimateConfig) -> ArmInSession:
        """Return the arm with other settings."""
        return replace(self, method=replace(self.method, config=config))


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
    frame: FrameData, body: Body, method: FrameMethod, out: Path | None, command: str = "estimate"
) -> tuple[Result, tuple[Path, ...]]:
    """Estimate the pose in a frame that was read, and write its result and overlay to the folder ``out`` if given.

    Arguments as in `solve_frame`; ``command`` is that which writes.

    Raises
    ------
    InputError
        As `solve_frame`; a name or folder that cannot be written to, in which case nothing is written.
    """
    if out is None:
        return solve_frame(frame, body, method)[1], ()
    check_output(out, frame.files.name)
    outcome = outcome_of(frame, body, method)
    with output(out, command, wait=LONG):
        return outcome.result, write_outcome(out, outcome)


def outcome_of(frame: FrameData, body: Body, method: FrameMethod) -> FrameOutcome:
    """Estimate and draw a frame that was read; arguments and errors as of `solve_frame`."""
    solved, result = solve_frame(frame, body, method)
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


def solve_frame(frame: FrameData, body: Body, method: FrameMethod) -> tuple[FrameData, Result]:
    """Estimate the pose in a frame that was read; in one without a mask, find that first, which is then in the frame.

    Errors as `estimate` and `segment_and_estimate`.
    """
    if any(view.given for view in frame.views):
        return frame, estimate_frame(frame, body, method)
    from dvrk_cmaes.estimation.image_frame import segment_and_estimate

    frame, _, result = segment_and_estimate(frame, body, method)
    return frame, result


def estimate_frame(data: FrameData, body: Body, method: FrameMethod) -> Result:
    """Estimate the pose in a frame with a mask that was read from its files; errors as `estimate`."""
    files = data.files
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


def estimated(arm: ArmInSession, files: FrameFiles) -> FrameOutcome:
    """Read and estimate one frame of an arm, whose result has failed where that is not possible; never raises."""
    try:
        return outcome_of(read_frame(files, arm.session.rig), arm.body, arm.method)
    except DvrkCmaesError as error:
        reason = str(error)
    except MemoryError:
        reason = "out of memory: try fewer workers, or a smaller image"
    except Exception as error:  # an error in one frame must not end the batch
        reason = internal_error(error)
    return failed_outcome(arm, files, reason)


def run_task(given: bytes, home: int, files: FrameFiles) -> FrameOutcome:
    """Estimate one frame in any process; arguments as of `shared`."""
    if os.getpid() != home:
        limit_library_threads()
    return estimated(unpacked(given), files)


def shared(arm: ArmInSession) -> tuple[bytes, int]:
    """Return what a process needs of an arm to estimate any frame of it, pickled, and the number of this process."""
    return packed(replace(arm, session=Session(arm.session.folder, arm.session.rig, (), SessionTruth()))), os.getpid()


def failed_outcome(arm: ArmInSession, files: FrameFiles, reason: str) -> FrameOutcome:
    """Return the outcome of a frame that has no pose, for a reason."""
    config, instrument = arm.method.config, arm.body.instrument
    result = Result.failed(
        files.name,
        relative_text(arm.session.folder, reason),
        files.readings,
        **instrument.stated,
        warnings=files.notes,
        remarks=arm.session.rig.remarks,
        time=files.time,
        seed=config.seed,
        config={**config.as_dict(), "instrument": instrument.describe_limits(arm.method.arm)},
    )
    pictures = (readable(partial(read_image, path)) for path in (files.image, files.mask) if path is not None)
    picture = next((picture for picture in pictures if picture is not None), None)
    return FrameOutcome(result, None if picture is None else encoded_image("overlay.jpg", draw_failed(result, picture)))


def relative_text(folder: Path, text: str) -> str:
    """Return a text on one line with paths relative to the session's folder, the same wherever that folder lies."""
    return " ".join((text if folder == Path() else text.replace(f"{folder}{os.sep}", "")).splitlines())
