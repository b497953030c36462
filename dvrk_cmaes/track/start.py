"""The filter's state from one pose: of the first frame, or found again after a loss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed, inverse
from dvrk_cmaes.joints.prior import reading_loss
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis
from dvrk_cmaes.track.modes import pruned
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.state import FilterState, Layout

Float64 = NDArray[np.float64]

_BASE_STD = (0.1, 1.0)  # m and rad, of a base of which nothing is known
_SPEED_STD = (0.03, 0.3, 1.0)  # m/s, rad/s about the root's x and y axes, rad/s about its z axis and of the joints


def unknown_state(
    config: EstimateConfig, motion: MotionModel, anchor: Anchor, names: tuple[str, ...], lag_std: float
) -> FilterState:
    """Return a state of which only the readings' errors are known; ``names`` are the joints'."""
    at = Layout(len(names))
    deviations = np.zeros(at.size)
    deviations[at.base] = [_BASE_STD[0]] * 3 + [_BASE_STD[1]] * 3
    deviations[at.roll] = np.deg2rad(config.session.roll_offset_deg) if anchor.outer_read else 0.0
    sigma = np.deg2rad([config.readings.of(name) for name in names])
    deviations[at.offsets] = np.where(anchor.joint_read, sigma, np.pi)
    state = FilterState(np.eye(4), np.zeros(1 + len(names)), np.eye(4), np.zeros(6 + len(names)), np.zeros((0, 0)))
    speeds = np.array([_SPEED_STD[0]] * 3 + [_SPEED_STD[1]] * 2 + [_SPEED_STD[2]] * (1 + len(names)))
    moving = np.concatenate([np.full(6, not anchor.outer_read), ~anchor.joint_read])
    deviations[at.rate] = speeds * moving
    covariance = np.diag(deviations**2)
    if anchor.outer_read:
        covariance[at.slack, at.slack] = motion.slack_covariance(state, anchor, lag_std)
    return FilterState(state.camera_from_base, state.offsets, state.slack, state.rate, covariance)


def placed(state: FilterState, motion: MotionModel, anchor: Anchor, at: Posed, covariance: Float64) -> FilterState:
    """Return the state whose pose and joints are given, with their covariance (6 + J, 6 + J).

    The base and the offsets of the joints take up the difference; slack and rates become zero.
    """
    anchored = motion.posed(FilterState(np.eye(4), state.offsets, np.eye(4), state.rate * 0, state.covariance), anchor)
    offsets = np.concatenate([state.offsets[:1], at.joints - anchor.joints])
    base = np.asarray(at.pose @ inverse(anchored.pose))
    mean = FilterState(base, offsets, np.eye(4), state.rate * 0, state.covariance)
    loadings = motion.loadings(mean, anchor)
    prior = state.covariance
    gain = np.linalg.solve(loadings @ prior @ loadings.T + covariance, loadings @ prior)
    after = prior - prior @ loadings.T @ gain
    return FilterState(base, offsets, mean.slack, mean.rate, (after + after.T) / 2)


def calibrated_state(calibration: SessionCalibration, blank: FilterState) -> FilterState:
    """Return a state with the base and the offsets of a session's calibration; ``blank`` has all the rest.

    The calibration's offset of insertion moves the base along the shaft, which the base's standard deviation allows
    for.
    """
    at = blank.layout
    keep = [*range(6), *range(7, 8 + at.joints)]  # all but insertion's offset
    covariance = blank.covariance.copy()
    index = np.arange(7 + at.joints)
    covariance[np.ix_(index, index)] = calibration.covariance_given_camera[np.ix_(keep, keep)]
    insertion = calibration.offsets["insertion"]
    moved = insertion**2 + calibration.spreads["slack_translation"] ** 2
    covariance[at.base, at.base] += np.diag([moved] * 3 + [0.0] * 3)
    spreads = [calibration.spreads[name] for name in list(calibration.offsets)[1:]]
    covariance[index[6:], index[6:]] += np.square(spreads)
    offsets = np.array(list(calibration.offsets.values()))[1:]
    return replace(blank, camera_from_base=calibration.camera_from_base, offsets=offsets, covariance=covariance)


def expected_pose(follower: Follower, config: EstimateConfig, calibration: SessionCalibration, anchor: Anchor) -> Posed:
    """Return the pose and the joints that readings of a calibrated session make expect."""
    blank = unknown_state(config, follower.motion, anchor, follower.instrument.joint_names, 0.0)
    return follower.motion.posed(calibrated_state(calibration, blank), anchor)


def starting_hypotheses(
    follower: Follower,
    config: EstimateConfig,
    calibration: SessionCalibration | None,
    anchor: Anchor,
    lag_std: float,
    result: Result,
) -> list[Hypothesis]:
    """Return a hypothesis for each mode of a single frame's result, without those that the readings rule out."""
    assert result.camera_from_root is not None
    assert result.covariance is not None
    names = follower.instrument.joint_names
    blank = unknown_state(config, follower.motion, anchor, names, lag_std)
    if calibration is not None and anchor.outer_read:
        blank = calibrated_state(calibration, blank)
        if anchor.expected is not None:
            read = np.concatenate([[True], anchor.joint_read])
            blank = replace(blank, offsets=np.where(read, anchor.expected, blank.offsets))
    sigma = np.deg2rad([config.readings.of(name) for name in names])
    first = (result.camera_from_root, result.joints, "")
    modes = [first, *((mode.camera_from_root, mode.joints, mode.relation) for mode in result.alternatives)]
    hypotheses = []
    for pose, joints, relation in modes[: config.track.modes]:
        at = Posed(pose, np.array([joints[name] for name in names]))
        score = 0.5 * float(reading_loss(at.joints, anchor.known, sigma))
        hypothesis = Hypothesis(blank, anchor, config.track.sigma_px, score, relation)
        if calibration is not None and anchor.outer_read:
            hypothesis, _ = follower.fused(hypothesis, at, result.covariance)
        else:
            state = placed(blank, follower.motion, anchor, at, result.covariance)
            hypothesis = replace(hypothesis, state=state)
        hypotheses.append(hypothesis)
    return pruned(hypotheses)


def based_on_arm(
    follower: Follower, config: EstimateConfig, hypothesis: Hypothesis, anchor: Anchor, lag_std: float
) -> Hypothesis:
    """Return a hypothesis with the arm's base where the outer joints are read for the first time, else as it is."""
    if hypothesis.anchor.based or not anchor.outer_read:
        return hypothesis
    return rebased(follower, config, hypothesis, anchor, lag_std)


def rebased(
    follower: Follower, config: EstimateConfig, hypothesis: Hypothesis, anchor: Anchor, lag_std: float
) -> Hypothesis:
    """Return a hypothesis with its pose and joints, and the arm's base and the offsets that readings then give it."""
    located, motion = follower.located(hypothesis), follower.motion
    blank = unknown_state(config, motion, anchor, follower.instrument.joint_names, lag_std)
    state = placed(blank, motion, anchor, located.at, located.covariance)
    return replace(hypothesis, state=state, anchor=anchor)
