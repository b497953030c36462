"""The result of an image from the hypothesis that is believed."""

from __future__ import annotations

from dataclasses import replace

from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis, Located


def described(
    follower: Follower, hypothesis: Hypothesis, result: TrackResult, located: Located | None = None
) -> TrackResult:
    """Return a result with the pose of a hypothesis, which is ``located`` if that is given."""
    located = follower.located(hypothesis) if located is None else located
    state, anchor, names = hypothesis.state, hypothesis.anchor, follower.instrument.joint_names
    read = dict(zip(("roll", *names), [anchor.outer_read, *anchor.joint_read.tolist()], strict=True))
    offsets = dict(zip(("roll", *names), state.offsets.tolist(), strict=True))
    return replace(
        result,
        camera_from_root=located.at.pose,
        joints=dict(zip(names, located.at.joints.tolist(), strict=True)),
        covariance=located.covariance,
        tips=located.tips,
        tip_std_mm=located.tip_std * 1e3 if len(located.tips) else None,
        camera_from_base=state.camera_from_base if anchor.outer_read else None,
        offsets={name: value for name, value in offsets.items() if read[name]},
    )


def without_pose(time: float, reason: str, *, searched: bool = False) -> TrackResult:
    """Return the result of an image before the first pose."""
    return TrackResult(time, "lost", (reason,), None, {}, None, None, None, searched=searched)
