"""The check of a session's blocks that are seen: what its frames show of camera, margin, sizes, lens and others.

Each is asked what the frames show of it by themselves, where all others are known as beforehand. What is left of it
widens the calibration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.calibration.blocks import BlockCheck, FoundBlock
from dvrk_cmaes.calibration.linearise import PASSES, Linearised, linearise
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN, square_left
from dvrk_cmaes.calibration.session_camera import CAMERA, IMPLAUSIBLE, camera_undetermined, places_of
from dvrk_cmaes.calibration.session_problem import Arms, ArmSession, MakeBlock
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.pose.expected_error import file_covariance

_LEAST_FRAMES = 6
_NOT_ASKED = "camera: not tested, as the settings say"


def check_blocks(arms: Arms, tested: Sequence[MakeBlock]) -> list[BlockCheck]:
    """Return what the frames of arms that are solved show of camera, margin and ``tested`` blocks.

    The camera is estimated with a wide prior, all others with its file as a measurement of it. Where the former is not
    plausible, only what the frames show at the camera of the file is left, which may contradict it or say nothing.
    """
    session, refined = arms[0].setup.config.session, arms[0].change is not None
    reasons = [camera_undetermined(arm.model, _LEAST_FRAMES, "test") for arm in arms]
    reason = None if None in reasons else reasons[0]
    if not session.test_camera and not refined:
        reason = _NOT_ASKED
    wide, passes = [arm.outlined(*tested, wide=True) for arm in arms], PASSES if reason is None and not refined else 1
    begun = [arm.linearised() for arm in wide]
    found = linearise(wide, session, passes=passes, first=begun)
    if far := passes > 1 and not all(one.plausible for one in found):
        found = linearise(wide, session, passes=1, first=begun)
    by_file = found
    if not refined and reason != _NOT_ASKED:
        by_file = linearise([arm.outlined(*tested, wide=False) for arm in arms], session, first=begun)
    each = zip(arms, found, by_file, wide, strict=True)
    return [_checked(arm, there, near, own.camera, reason, far=far) for arm, there, near, own in each]


def _checked(
    arm: ArmSession, there: Linearised, near: Linearised, camera: Camera, reason: str | None, *, far: bool
) -> BlockCheck:
    """Judge the estimates of an arm with a wide prior of the camera, and ``near`` its file.

    ``reason`` is why the camera is not tested, ``far`` whether its estimate was not plausible.
    """
    config, blocks = arm.setup.config, dict[str, FoundBlock]()
    errors, covariance = file_covariance(camera, config.camera), np.zeros((arm.calibration.own,) * 2)
    for block in there.blocks:
        alone, spread = (there if block.name == CAMERA else near).shown_of(block)
        found, left = block.stated(alone, config.session.shared_errors**2 * spread if block.is_alike else spread)
        if block.name == MARGIN and arm.margin is not None:
            found, left = arm.margin, square_left(arm.margin)
        moves, of_errors = near.moved_by(block), np.ix_(*[places_of(block.parameters)] * 2)
        if block.name == CAMERA and (reason or (far and not found.doubt)):
            reason, left = reason or IMPLAUSIBLE, errors[of_errors]
        else:
            blocks[block.name] = found.moving(moves)
        if block.parameters:
            errors[of_errors] = left
        if block.widens:
            covariance += moves @ left @ moves.T
    return BlockCheck(reason or "", covariance, errors, blocks)
