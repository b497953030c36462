"""Whether the mode that is followed is believed, if the image in which it was found left it in doubt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.search.modes import are_distinct
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis

_ENOUGH = 1.0
_OF_AN_IMAGE = {"ok": 1.0, "doubtful": 0.5}  # what an image that was solved by itself counts for, if it agrees
_AFTER_A_CHANGE = 0.5
_FIRST_WAIT, _MOST_WAIT = 5, 32  # images between those that are solved by themselves
_SAME_TIPS = 3e-3  # m, between the tips of two poses that agree

UNCONFIRMED = "mode not confirmed: an image left it in doubt, and none since, solved by itself, has agreed with it"
CHANGED = "switched to the pose of this image solved by itself: the one that was followed had not been confirmed"


@dataclass
class Confirmation:
    """How far later images, solved by themselves, have confirmed the mode that is followed.

    The pose is believed when ``credit`` reaches 1. ``left`` images pass before the next one is solved; that number is
    doubled each time, from ``wait`` on.
    """

    credit: float = _ENOUGH
    left: int = _FIRST_WAIT
    wait: int = _FIRST_WAIT

    @property
    def needed(self) -> bool:
        """Whether the pose is not believed yet."""
        return self.credit < _ENOUGH

    def start(self, result: Result, *, changed: bool = False) -> None:
        """Start from the result of one image; ``changed`` tells that another pose had been followed until then."""
        self.credit = _AFTER_A_CHANGE if changed else float(result.status == "ok")
        self.left = self.wait = _FIRST_WAIT

    def doubt(self) -> None:
        """Doubt the pose that is followed: it may be of another mode than that of the images before."""
        self.credit = 0.0
        self.left = self.wait = _FIRST_WAIT

    def due(self) -> bool:
        """Count an image that supports the pose; return whether to solve it by itself."""
        self.left -= 1
        if self.left > 0:
            return False
        self.wait = min(2 * self.wait, _MOST_WAIT)
        self.left = self.wait
        return True

    def add(self, follower: Follower, followed: Hypothesis, result: Result) -> bool:
        """Add an image that was solved by itself; return whether it agrees with the followed pose."""
        agrees = agree(follower, followed, result)
        if agrees:
            self.credit += _OF_AN_IMAGE.get(result.status, 0.0)
        return agrees


def agree(follower: Follower, followed: Hypothesis, result: Result) -> bool:
    """Whether the pose and the joints of an image solved by itself are of the mode that is followed."""
    if result.camera_from_root is None:
        return False
    joints = np.array([result.joints[name] for name in follower.instrument.joint_names])
    if are_distinct(follower.posed(followed), Posed(result.camera_from_root, joints)):
        return False
    tips, ends = follower.located(followed).tips, np.array(result.tips).reshape(-1, 3)
    apart = np.linalg.norm(tips - ends, axis=1) if len(tips) == len(ends) else np.zeros(1)
    return bool(apart.max() < _SAME_TIPS)
