"""One frame from what was read to what is written: estimate, draw, write. What every command does with a frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.arm import Arm
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.io.frame_files import FrameData, FrameFiles
from dvrk_cmaes.report.files import check_output, write_frame
from dvrk_cmaes.report.overlay import draw_overlay
from dvrk_cmaes.result import Result
from dvrk_cmaes.silhouette import Body


@dataclass(frozen=True, eq=False)
class FrameRun:
    """A frame's result, and the files written: JSON and overlay, if any."""

    result: Result
    written: tuple[Path, ...]


def run_frame(
    files: FrameFiles, data: FrameData, body: Body, *, arm: Arm, config: EstimateConfig, out: Path | None
) -> FrameRun:
    """Estimate the pose in a frame that was read from its files; with ``out``, write its result and overlay there.

    Raises
    ------
    InputError
        As `estimate`; a name or folder that cannot be written to. Nothing is written then.
    """
    if out is not None:
        check_output(out, files.name)
    result = estimate_frame(files, data, body, arm=arm, config=config)
    if out is None:
        return FrameRun(result, ())
    return FrameRun(result, write_frame(out, result, draw_frame(result, files, data, body)))


def estimate_frame(files: FrameFiles, data: FrameData, body: Body, *, arm: Arm, config: EstimateConfig) -> Result:
    """Estimate the pose in a frame that was read from its files; errors as `estimate`."""
    return estimate(
        data.mask,
        data.camera,
        files.readings,
        body,
        ignore=data.ignore,
        keypoints=files.keypoints,
        arm=arm,
        frame=files.name,
        config=config,
        warnings=data.notes,
    )


def draw_frame(result: Result, files: FrameFiles, data: FrameData, body: Body) -> NDArray[np.uint8]:
    """Draw a frame's result over its image, or where there is none, over its mask: (H, W, 3) BGR."""
    return draw_overlay(
        result, data.mask, data.camera, body, image=data.image, ignore=data.ignore, keypoints=files.keypoints
    )
