"""The image from which a recording is followed that has no masks and whose keyframes cannot be solved.

The first image may show something else than the instrument, or hide it. Images over the recording are solved by
themselves, until the pose of one explains its mask; the recording is followed from there to its end, and back to its
beginning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.estimation.image_frame import segment_and_estimate
from dvrk_cmaes.frames.frame import FrameFiles, read_frame_image
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.runs.track_clock import TrackClock
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.recovery import explains

_TRIED: Final = 6  # images, at most, that are solved by themselves


def starting_frame(
    frames: Sequence[FrameFiles], rig: Rig, body: Body, arm: Arm, config: EstimateConfig, *, use_joints: bool
) -> int:
    """Return the number of the frame from which to follow: the first of some over the recording that is explained.

    That is 0 where none of them is. InputError for a file that is wrong.
    """
    if frames[0].has_mask:
        return 0
    count = min(_TRIED, len(frames))
    for number in sorted({round(k * len(frames) / count) for k in range(count)}):
        files = frames[number] if use_joints else frames[number].changed(readings={})
        if files.problem is None and files.has_image and is_explained(files, rig, body, arm, config):
            return number
    return 0


def is_explained(files: FrameFiles, rig: Rig, body: Body, arm: Arm, config: EstimateConfig) -> bool:
    """Whether the pose that an image yields by itself explains the mask that was found in it."""
    data = read_frame_image(files, rig)
    try:
        solved = segment_and_estimate(data, files, body, arm=arm, config=config)
    except InputError:
        raise
    except DvrkCmaesError:
        return False
    return solved.segmentation.confidence >= GUESS and explains(solved.result, config.trust)


def mirrored(clock: TrackClock) -> TrackClock:
    """Return a clock that runs backwards: the last frame and the last readings come first."""
    times: Mapping[str, float] = {name: -time for name, time in clock.times.items()}
    return replace(clock, times=times, readings=tuple((-time, row) for time, row in reversed(clock.readings)))
