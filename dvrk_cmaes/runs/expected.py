"""Frames whose images show the instrument elsewhere than most others of the session expect it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Final

from dvrk_cmaes.calibration.calibrate import in_threads
from dvrk_cmaes.calibration.session_frame import SessionFrame
from dvrk_cmaes.calibration.session_loop import predict_from_first
from dvrk_cmaes.calibration.session_problem import ArmSetup
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import ArmInSession

_FEWEST: Final = 6  # frames with a pose, by which others are expected


def expected_elsewhere(arm: ArmInSession, results: Mapping[str, Result]) -> list[FrameFiles]:
    """Return the frames whose masks were found in images and do not agree with most others on where the base is.

    ``results`` are those of frames by name, each by its own image. Each frame that is returned starts where those that
    agree expect it; one in which nothing was found is among them. There are none if fewer than 70 % of them agree.
    """
    body, method, session = arm.body, arm.method, arm.session
    images = {own.name: own for own in session.frames if own.has_image and not own.has_mask and own.prompts is None}
    frames = [
        SessionFrame(name, partial(read_frame, own, session.rig), results[name], time=own.time)
        for name, own in images.items()
        if name in results
    ]
    found = [frame for frame in frames if not frame.lacks]
    by_classic = method.segment is None or method.segment.model == "classic"
    if len(found) < _FEWEST or method.session is not None or not by_classic:
        return []
    config = method.config.with_alike_masks()
    run = partial(in_threads, body, config)
    setup = ArmSetup(session.reading_series(), body.instrument, method.arm, config, run)
    expected = predict_from_first(found, {frame.name: images[frame.name].readings for frame in frames}, setup)
    names = body.instrument.joint_names
    return [replace(images[name], start=start_at(found[0].result, at, names)) for name, at in expected.items()]


def start_at(like: Result, at: Posed, names: tuple[str, ...]) -> Result:
    """Return the result of a frame ``like`` another one's, at a pose that is expected, from which it starts."""
    joints = dict(zip(names, at.joints.tolist(), strict=True))
    return replace(like, camera_from_root=at.pose, joints=joints, alternatives=())
