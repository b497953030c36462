"""Finding a lost instrument again: around the prediction first, then by the global search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import EstimateConfig, TrustConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.geometry import change_between, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.segment.segmentation import Box
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis
from dvrk_cmaes.track.judge import is_supported
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.rig_outline import RigEvidence
from dvrk_cmaes.track.rig_sight import RigSeen, RigSight
from dvrk_cmaes.track.start import expected_pose
from dvrk_cmaes.track.state import FilterState
from dvrk_cmaes.track.update import Fit

Float64 = NDArray[np.float64]

_WIDENED = (4e-3, 0.12, 0.35, 0.35)  # m; rad about the root's x and y axes, about its z axis, and of the joints
_SAME_BASE = 60.0  # squared deviation from the prediction up to which a pose found again is of the same base
_DOUBTFUL = 0.25  # part of an image without support that one with doubtful support counts for
_OUT_OF_VIEW = 0.1  # the same of an image in which the instrument is not expected to be seen
_SEARCH_AFTER = 2.0  # images without support before a global search
_MOST_WAIT = 32.0  # images between global searches
_CERTAIN = {"mask": 0.85, "image": 0.6}  # least such difference of a pose that was found around a wrong prediction
_CLEARLY = 0.1  # difference of the shares of supported outline less unexplained edges
_HELD = (3e-3, 0.08, 0.2, 0.2)


def _widened(state: FilterState, sizes: tuple[float, float, float, float]) -> FilterState:
    """Return a state with larger standard deviations of the pose and the joints."""
    at = state.layout
    covariance = state.covariance.copy()
    diagonal = np.einsum("ii->i", covariance)
    diagonal[at.slack] += np.square([sizes[0]] * 3 + [sizes[1]] * 2 + [sizes[2]])
    diagonal[at.offsets] += sizes[3] ** 2
    return replace(state, covariance=covariance)


def search_around(
    follower: Follower, before: Hypothesis, predicted: Hypothesis, evidence: RigEvidence
) -> tuple[Hypothesis, Fit] | None:
    """Search for a pose around the prediction, and around the pose before that, and return the better supported.

    The latter is found where readings jumped, or stopped while the instrument moves on.
    """
    motion = follower.motion
    pose, joints = motion.pose(before.state, before.anchor)
    moved, bent = motion.pose(predicted.state, predicted.anchor)
    slack = predicted.state.slack @ inverse(moved) @ pose
    offsets = np.concatenate([predicted.state.offsets[:1], predicted.state.offsets[1:] + joints - bent])
    held = replace(predicted, state=_widened(replace(predicted.state, slack=slack, offsets=offsets), _HELD))
    around = replace(predicted, state=_widened(predicted.state, _WIDENED))
    starts = [around]
    if np.abs(change_between(moved, pose)).max() > 1e-4 or np.abs(joints - bent).max() > 1e-3:
        starts.append(held)
    wider = evidence.wider()
    found = [one for start in starts if (one := follower.corrected(start, wider)) is not None]
    return max(found, key=lambda one: one[1].supported - one[1].unexplained, default=None)


@dataclass(frozen=True, eq=False)
class GlobalSearch:
    """Solves an image by itself, with the settings of a single frame."""

    follower: Follower
    sight: RigSight
    body: Body
    config: EstimateConfig
    calibration: SessionCalibration | None

    def __call__(self, seen: RigSeen, anchor: Anchor, *, first: bool = False) -> Result | None:
        """Solve an image; None if its mask has no instrument, or nothing but instrument, or no mask is found in it.

        ``first`` tells that it is the first image, for which the hints are.
        """
        masks = self.sight.masks(seen, hinted=first, around=self._around(anchor) if first else {})
        if not masks:
            return None
        rig, ignore, readings = self.follower.model.rig, self.sight.ignored(seen), self._readings(anchor)
        session, config = self.calibration, self.config
        try:
            return estimate(masks, rig, readings, self.body, ignore=ignore, session=session, config=config)
        except InputError:
            return None

    def _readings(self, anchor: Anchor) -> dict[str, float]:
        """Return readings by name."""
        found = dict(zip(OUTER_JOINTS, anchor.outer.tolist(), strict=True)) if anchor.outer_read else {}
        names = self.follower.instrument.joint_names
        read = zip(names, anchor.joints.tolist(), anchor.joint_read, strict=True)
        return found | {name: value for name, value, known in read if known}

    def _around(self, anchor: Anchor) -> dict[int, Box]:
        """Return boxes, by view, around the instrument where readings and calibration make expect it."""
        if self.calibration is None or not anchor.outer_read:
            return {}
        model = self.follower.model
        pose, joints = expected_pose(self.follower, self.config, self.calibration, anchor)
        rim = model.draw(pose, joints, tuple(range(len(model.rig.views))))
        return {} if rim is None else self.sight.boxes_of(rim)


def same_base(follower: Follower, main: Hypothesis, result: Result, evidence: RigEvidence) -> Hypothesis | None:
    """Return the predicted hypothesis corrected by the nearest mode of a single frame's result, and by the image.

    None if no mode is near enough to be of the same base, or the image does not support it.
    """
    if result.camera_from_root is None or result.covariance is None:
        return None
    names = follower.instrument.joint_names
    modes = [(result.camera_from_root, result.joints)]
    modes += [(one.camera_from_root, one.joints) for one in result.alternatives]
    fused = [
        follower.fused(main, pose, np.array([joints[name] for name in names]), result.covariance)
        for pose, joints in modes
    ]
    nearest, deviation = min(fused, key=lambda one: one[1])
    corrected = follower.corrected(nearest, evidence) if deviation < _SAME_BASE else None
    return None if corrected is None or not is_supported(corrected[1], follower.config) else corrected[0]


def explains(result: Result, trust: TrustConfig) -> bool:
    """Whether the pose of a single frame explains its mask, whatever the readings say."""
    quality = result.quality
    return (
        quality is not None
        and quality.iou >= trust.least_iou
        and quality.distal_px <= trust.largest_distal_px
        and quality.bend_px <= trust.largest_bend_px
    )


@dataclass
class Searching:
    """When to search globally: images without support so far, and how many there must be for the next search.

    An image that supports the pose, but not convincingly, counts as a part of one.
    """

    unsupported: float = 0.0
    wait: float = _SEARCH_AFTER

    def missed(self, *, doubtful: bool, out_of_view: bool = False) -> bool:
        """Count an image without support, or with doubtful support; return whether to search in it.

        ``out_of_view`` tells that the instrument is not expected to be seen in it.
        """
        self.unsupported += _DOUBTFUL if doubtful else _OUT_OF_VIEW if out_of_view else 1.0
        if self.unsupported < self.wait:
            return False
        self.wait = min(2 * self.wait, self.wait + _MOST_WAIT)
        return True


def is_better(fit: Fit, other: Fit) -> bool:
    """Whether a fit is clearly better supported than another."""
    return fit.supported - fit.unexplained > other.supported - other.unexplained + _CLEARLY


def is_certain(fit: Fit, source: str) -> bool:
    """Whether a pose that was found around a wrong prediction fits its mask or image too well for a local optimum."""
    return fit.supported - fit.unexplained >= _CERTAIN[source]
