"""Finding a lost instrument again: around the prediction first, then by the global search."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import EstimateConfig, TrackConfig, TrustConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.geometry import Posed, inverse, moved
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.pose.search.modes import are_distinct, is_twin
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.segment.segmentation import Box
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.sliced_call import stage
from dvrk_cmaes.track.evidence import Evidence
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis
from dvrk_cmaes.track.judge import is_supported
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.searching import is_better
from dvrk_cmaes.track.sight import Seen, Sight
from dvrk_cmaes.track.start import expected_pose
from dvrk_cmaes.track.state import FilterState
from dvrk_cmaes.track.update import Fit

Float64 = NDArray[np.float64]

_JUMP = 0.17  # rad, change of a joint that readings do not make from one image to the next
_WIDENED = (4e-3, 0.12, 0.35, 0.35)  # m; rad about the root's x and y axes, about its z axis, and of the joints
_HELD = (3e-3, 0.08, 0.2, 0.2)
_KNOWN_JOINT = 0.06  # rad, instead of that of the joints, where readings tell how the instrument moves
_ROLLS = np.deg2rad([-60.0, -30.0, 30.0, 60.0])  # from the prediction, where no reading tells how it moved
_PASSES = 2  # further corrections of the best pose that was found
_JOINT_PENALTY = 0.3  # of agreement for each rad that the joints are changed
_SAME_BASE = 60.0  # squared deviation from the prediction up to which a pose found again is of the same base
_CERTAIN = {"mask": 0.85, "image": 0.6}  # least agreement of a pose that was found around a wrong prediction
_LIKELY = {"mask": 0.85, "image": 0.4}  # the same where the image does not support the prediction at all


def _widened(
    state: FilterState, sizes: tuple[float, float, float, float], known: NDArray[np.bool_] | bool = False
) -> FilterState:
    """Return a state with larger standard deviations of the pose and the joints, of which (J,) are ``known``."""
    at = state.layout
    covariance = state.covariance.copy()
    diagonal = np.einsum("ii->i", covariance)
    diagonal[at.slack] += np.square([sizes[0]] * 3 + [sizes[1]] * 2 + [sizes[2]])
    diagonal[at.offsets] += np.where(known, _KNOWN_JOINT, sizes[3]) ** 2
    return replace(state, covariance=covariance)


def _rolled(state: FilterState, angle: float) -> FilterState:
    """Return a state whose root is turned about its z axis by an angle, rad."""
    return replace(state, slack=moved(state.slack, np.array([0.0, 0.0, 0.0, 0.0, 0.0, angle])))


def search_around(
    follower: Follower,
    before: Hypothesis,
    predicted: Hypothesis,
    corrected: Hypothesis | None,
    evidence: Evidence,
) -> tuple[Hypothesis, Fit] | None:
    """Search for a pose around a prediction that an image does not support well, and return the best supported.

    It starts from the prediction, from where the image ``corrected`` it to, and from the pose ``before``, where
    readings jumped, or stopped while the instrument moves on. Where the roll is not read, or its reading stands still,
    the instrument is also turned about its shaft. Of poses that are supported alike, the one whose joints change less
    is returned.
    """
    last, ahead = follower.posed(before), follower.posed(predicted)
    moves = predicted.anchor.moves_from(before.anchor)
    known = predicted.anchor.joint_read & moves & (np.abs(ahead.joints - last.joints) < _JUMP)
    slack = predicted.state.slack @ inverse(ahead.pose) @ last.pose
    offsets = np.concatenate([predicted.state.offsets[:1], predicted.state.offsets[1:] + last.joints - ahead.joints])
    held = replace(predicted, state=_widened(replace(predicted.state, slack=slack, offsets=offsets), _HELD, known))
    starts = [replace(predicted, state=_widened(predicted.state, _WIDENED, known))]
    change = np.abs(last.minus(ahead))
    if change[:6].max() > 1e-4 or change[6:].max() > 1e-3:
        starts.append(held)
    if corrected is not None:
        starts.append(replace(corrected, state=_widened(corrected.state, _WIDENED, known)))
    if not moves:
        turned = (starts[0],) if corrected is None else (starts[0], corrected)
        starts += [replace(start, state=_rolled(start.state, angle)) for start in turned for angle in _ROLLS]

    def merit(pair: tuple[Hypothesis, Fit]) -> float:
        hypothesis, fit = pair
        change = follower.posed(hypothesis).joints - last.joints
        return fit.agreement - _JOINT_PENALTY * float(np.linalg.norm(change))

    wider = evidence.wider()
    all_corrected = [pair for start in starts if (pair := follower.corrected(start, wider)) is not None]
    best = max(all_corrected, key=merit, default=None)
    for _ in range(_PASSES):
        if best is None:
            break
        again = follower.corrected(replace(best[0], state=_widened(best[0].state, _HELD, known)), evidence)
        if again is None or merit(again) <= merit(best):
            break
        best = again
    return best


def has_jumped(follower: Follower, before: Hypothesis, after: Hypothesis) -> bool:
    """Whether a found pose may be of another mode than that before: its mirror twin, or one with other joints.

    How far the instrument rolled does not tell: nothing may have read that.
    """
    was, found = follower.posed(before), follower.posed(after)
    joints_differ = are_distinct(was, Posed(was.pose, found.joints))
    return bool(joints_differ) or (follower.instrument.has_twin and is_twin(follower.instrument, was, found))


@dataclass(frozen=True, eq=False)
class GlobalSearch:
    """Solves an image by itself, with the settings of a single frame."""

    follower: Follower
    sight: Sight
    body: Body
    config: EstimateConfig
    calibration: SessionCalibration | None

    def __call__(self, seen: Seen, anchor: Anchor, *, first: bool = False) -> Result | None:
        """Solve an image; None if its mask has no instrument, or nothing but instrument, or no mask is found in it.

        ``first`` tells that it is the first image, for which the hints are.
        """
        masks = self.sight.masks(seen, hinted=first, around=self._around(anchor) if first else {})
        if not masks:
            return None
        stage("")  # what is drawn for the search is not done in the step that found the masks
        rig, ignore, readings = self.follower.model.rig, self.sight.ignored(seen), self._readings(anchor)
        session, config = self.calibration, self.config
        try:
            return estimate(masks, rig, readings, self.body, ignore=ignore, session=session, config=config)
        except InputError:
            return None

    def _readings(self, anchor: Anchor) -> dict[str, float]:
        """Return readings by name; those of joints that stand still, too, which tell one mode from another."""
        outer = dict(zip(OUTER_JOINTS, anchor.outer.tolist(), strict=True)) if anchor.outer_read else {}
        names = self.follower.instrument.joint_names
        read = zip(names, anchor.known.tolist(), strict=True)
        return outer | {name: value for name, value in read if not math.isnan(value)}

    def _around(self, anchor: Anchor) -> dict[int, Box]:
        """Return boxes, by view, around the instrument where readings and calibration make expect it."""
        if self.calibration is None or not anchor.outer_read:
            return {}
        model = self.follower.model
        at = expected_pose(self.follower, self.config, self.calibration, anchor)
        outline = model.draw(at, tuple(range(len(model.rig.views))))
        return {} if outline is None else self.sight.boxes_of(outline)


def same_base(
    follower: Follower, main: Hypothesis, result: Result, evidence: Evidence
) -> tuple[Hypothesis, Fit] | None:
    """Return the predicted hypothesis corrected by the nearest mode of a single frame's result, and by the image.

    None if no mode is near enough to be of the same base, or the image does not support it.
    """
    if result.camera_from_root is None or result.covariance is None:
        return None
    names = follower.instrument.joint_names
    modes = [(result.camera_from_root, result.joints)]
    modes += [(mode.camera_from_root, mode.joints) for mode in result.alternatives]
    fused = [
        follower.fused(main, Posed(pose, np.array([joints[name] for name in names])), result.covariance)
        for pose, joints in modes
    ]
    nearest, deviation = min(fused, key=lambda pair: pair[1])
    corrected = follower.corrected(nearest, evidence) if deviation < _SAME_BASE else None
    return None if corrected is None or not is_supported(corrected[1], follower.config) else corrected


def explains(result: Result, trust: TrustConfig) -> bool:
    """Whether the pose of a single frame explains its mask, whatever the readings say."""
    quality = result.quality
    return (
        quality is not None
        and quality.iou >= trust.least_iou
        and quality.distal_px <= trust.largest_distal_px
        and quality.bend_px <= trust.largest_bend_px
    )


def is_certain(fit: Fit, source: str) -> bool:
    """Whether a pose that was found around a wrong prediction fits its mask or image too well for a local optimum."""
    return fit.agreement >= _CERTAIN[source]


def is_likely(fit: Fit | None, source: str, config: TrackConfig) -> bool:
    """Whether a mask or image supports a pose that was found, if any, well enough to follow it, but not to be ok."""
    return fit is not None and is_supported(fit, config) and fit.agreement >= _LIKELY[source]


def is_followed_instead(found: Fit, followed: Fit | None, source: str, config: TrackConfig) -> bool:
    """Whether a pose that was found around a prediction is followed from then on, and not what that was corrected to.

    It must be certain, or likely where the ``followed`` one is not supported at all, and fit better.
    """
    lost = followed is None or not is_supported(followed, config)
    believed = is_certain(found, source) or (lost and is_likely(found, source, config))
    return believed and (followed is None or is_better(found, followed))
