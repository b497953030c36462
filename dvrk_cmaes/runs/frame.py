"""One frame from what was read to what is written: estimate, draw, write. What every command does with a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.paths import check_output, write_frame
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body


@dataclass(frozen=True, eq=False)
class FrameRun:
    """A frame's result, and the files written: JSON, overlay, and the mask if it was found, if any."""

    result: Result
    written: tuple[Path, ...]


def run_frame(
    files: FrameFiles,
    data: FrameData,
    body: Body,
    *,
    arm: Arm,
    config: EstimateConfig,
    out: Path | None,
    session: SessionCalibration | None = None,
) -> FrameRun:
    """Estimate the pose in a frame that was read from its files; with ``out``, write its result and overlay there.

    Raises
    ------
    InputError
        As `estimate`; a name or folder that cannot be written to. Nothing is written then.
    """
    if out is not None:
        check_output(out, files.name)
    result = estimate_frame(files, data, body, arm=arm, config=config, session=session)
    if out is None:
        return FrameRun(result, ())
    overlay = draw_frame(result, files, data, body)
    return FrameRun(result, write_frame(out, result, overlay, None if data.segmentation is None else data.mask))


def estimate_frame(
    files: FrameFiles,
    data: FrameData,
    body: Body,
    *,
    arm: Arm,
    config: EstimateConfig,
    session: SessionCalibration | None = None,
) -> Result:
    """Estimate the pose in a frame that was read from its files; errors as `estimate`.

    Where the mask was found in the image, the result says so, is doubtful if the mask is a guess, and if it is
    doubtful, says whether mask or pose is to blame.
    """
    result = estimate(
        data.mask,
        data.camera,
        files.readings,
        body,
        ignore=data.ignore,
        keypoints=files.keypoints,
        arm=arm,
        session=session,
        frame=files.name,
        config=config,
        warnings=data.notes,
    )
    found = data.segmentation
    if found is None or data.image is None:
        return result
    from dvrk_cmaes.segment.confidence import GUESS
    from dvrk_cmaes.segment.mask_or_pose import who_is_to_blame
    from dvrk_cmaes.segment.with_instrument import drawn

    reasons = result.reasons
    if found.confidence < GUESS:
        reasons = (*reasons, f"mask is a guess: confidence {found.confidence:.2f}, expected at least {GUESS}")
    if reasons:
        silhouette = drawn(result, data.camera, body)
        reasons = (*reasons, f"mask or pose: {who_is_to_blame(data.image, found, silhouette, data.ignore)}")
    status = "doubtful" if reasons else result.status
    return replace(result, status=status, reasons=reasons, seconds=result.seconds + data.segment_seconds)


def draw_frame(result: Result, files: FrameFiles, data: FrameData, body: Body) -> NDArray[np.uint8]:
    """Draw a frame's result over its image, or where there is none, over its mask: (H, W, 3) BGR."""
    return draw_overlay(
        result, data.mask, data.camera, body, image=data.image, ignore=data.ignore, keypoints=files.keypoints
    )
