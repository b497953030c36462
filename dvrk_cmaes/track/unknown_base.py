"""Following while no calibration is known: by a wide one, made from a pose of an image that was searched.

A pose gives the base of an arm whose readings are known, up to its own errors and the offsets of roll and joints. Where
nothing is read, the arm is taken to stand still, and the base to walk at random. No pose is ok, since nothing but the
images determines the base.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from dvrk_cmaes.calibration.blocks import BASE_AXES, OUTER_OFFSETS
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import SessionModel, offset_deviations
from dvrk_cmaes.calibration.prediction import FoundLag
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.geometry import Float64, Posed, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.pose.doubts import (
    NOT_FOUND,
    mask_cut_straight,
    overlap_too_low,
    reasons,
    search_running,
    wrist_or_jaws_off,
)
from dvrk_cmaes.results.parts import posed
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult, without_pose
from dvrk_cmaes.track.follower import Followed, Follower
from dvrk_cmaes.track.reading_buffer import ReadingAt
from dvrk_cmaes.track.view_segmenter import Seen

_MOST_IMAGES = 90  # that come during a search, after which it is given up
_FIRST_WAIT, _MORE_WAIT = 3, 30  # images without support until the first search, and most between two of them
_USUAL_IOU = 0.85  # of a pose and its mask
_BASE_STD = (0.1, 1.0)  # m and rad, of a base of which nothing is known
_OWN_ERROR = 2.0  # factor on the stated errors of a searched image, which is then followed itself
_WALK = (0.02, 0.5, 1.0)  # m, rad about the root's x and y, about its z and of the joints, in a second without readings


def wide_calibration(at: Posed, covariance: Float64, reading: ReadingAt, given: Followed) -> SessionCalibration:
    """Return the calibration that a pose with a covariance (D, D) makes of the readings at its time."""
    instrument, arm, config = given.instrument, given.arm, given.config
    names = instrument.joint_names
    offsets = np.concatenate([[0.0, 0.0], at.joints - np.nan_to_num(reading.joints)])
    read = dict(zip((*OUTER_JOINTS, *names), [*reading.outer.tolist(), *reading.joints.tolist()], strict=True))
    model = SessionModel.of([read], instrument, config, arm)
    base = np.asarray(at.pose @ inverse(model.base_from_root(offsets)[0]))
    jacobian = model.jacobian(model.calibration(base, offsets))[0]
    before = np.diag([_BASE_STD[0] ** 2] * 3 + [_BASE_STD[1] ** 2] * 3 + [*offset_deviations(config, names) ** 2])
    gain = np.linalg.solve(jacobian @ before @ jacobian.T + covariance, jacobian @ before)
    after = before - before @ jacobian.T @ gain
    after = (after + after.T) / 2
    return SessionCalibration(
        instrument=instrument.name,
        camera_from_base=base,
        offsets=dict(zip((*OUTER_OFFSETS, *names), offsets.tolist(), strict=True)),
        axes=(*BASE_AXES, *OUTER_OFFSETS, *names),
        covariance=after,
        covariance_given_camera=after,
        spreads=model.spreads,
        arm=arm,
        roll_offset=instrument.roll_offset,
        iou=_USUAL_IOU,
    )


@dataclass(frozen=True, eq=False)
class _Image:
    """An image, its time, s, and the readings then."""

    time: float
    reading: ReadingAt
    seen: Seen


@dataclass(eq=False)
class UnknownBase:
    """Searches for an instrument, and follows it while no calibration is known.

    ``background`` is whether a search is done in a thread while the steps after its image go on. ``following`` is what
    follows the pose, at the last image.
    """

    given: Followed
    background: bool
    following: Follower | None = None
    _last: tuple[float, Posed, Float64] | None = None  # time, s, pose and covariance (D, D) of what is followed
    _reads: bool = False  # whether readings of a moving arm have stated how it moves since its base was made
    _found: Future[Result | None] | None = None  # the result of the search of an image, ...
    _images: list[_Image] = field(default_factory=list)  # ... and that image with all that have come since
    _unsupported: int = 0
    _wait: int = _FIRST_WAIT

    @property
    def searching(self) -> bool:
        """Whether an image is being searched."""
        return self._found is not None

    def forget(self) -> None:
        """Forget what was followed; the next image is searched."""
        self.following, self._last, self._found = None, None, None

    def start(self, time: float, result: Result, seen: Seen | None = None, *, widened: float = 1.0) -> None:
        """Follow the pose of a single frame's result from its time, s, on; colours are learned where it is seen.

        ``widened`` is a factor on the standard deviations that the result states.
        """
        assert result.covariance is not None
        self.forget()
        at = posed(result, self.given.instrument.joint_names)
        self._last = time, at, widened**2 * result.covariance
        self._unsupported, self._wait = 0, _FIRST_WAIT
        if seen is not None:
            self.given.segmenter.learn(seen, self.given.rig.views, at)

    def step(
        self, time: float, reading: ReadingAt, seen: Seen, calibration: SessionCalibration | None = None
    ) -> TrackResult:
        """Follow to the image of a later time, s, whose readings, less the lag, are ``reading``.

        A ``calibration`` that cannot be used for want of colours predicts where a searched image has the instrument.
        """
        image = _Image(time, reading, seen)
        if self._last is None and self._found is None:
            if seen.problem is not None:
                return without_pose(time, seen.problem)
            self._begin_search(image, calibration)
        searched, images = self.searching, self._after_search(image)
        results = [self._follow(each, calibration) for each in images]
        if not results:
            found = search_running(self._images[0].time) if self.searching else NOT_FOUND
            return without_pose(time, found, searched=True)
        return replace(results[-1], searched=searched)

    def _begin_search(self, image: _Image, calibration: SessionCalibration | None) -> None:
        """Begin to search an image."""
        kept, given = replace(image, seen=image.seen.copied()), self.given
        if self.background:
            given = replace(given, config=replace(given.config, threads=1))
        executor = ThreadPoolExecutor(1)
        self._found = executor.submit(_solved, kept, given, calibration, first=self._last is None)
        self._images = [kept]
        executor.shutdown(wait=not self.background)  # the thread ends with the search, and the program after it

    def _after_search(self, image: _Image) -> list[_Image]:
        """Return the images that are followed in this step: those since a searched one in which a pose was found.

        So where the instrument is followed to does not depend on how long a search takes.
        """
        images = [] if self._last is None else [image]
        if self._found is None:
            return images
        began = self._images[0]
        if image.time > began.time:
            self._images.append(replace(image, seen=image.seen.copied()))
        if not self._found.done():
            self._found = None if len(self._images) > _MOST_IMAGES else self._found
            return images
        found, self._found = self._found.result(), None
        if found is None or found.camera_from_root is None or found.covariance is None:
            return images
        if self._last is not None and not _explains(found, self.given):
            return images
        self.start(began.time, found, began.seen, widened=_OWN_ERROR)
        return self._images

    def _follow(self, image: _Image, calibration: SessionCalibration | None) -> TrackResult:
        """Follow the pose to an image; where images do not support it for some time, one is searched."""
        reading, names = image.reading, self.given.instrument.joint_names
        assert self._last is not None
        (time, at, covariance), reads = self._last, reading.has_outer and not reading.still
        used = reading if reads else _standing(reading, at)
        if self.following is None or not (reads and self._reads):
            walked = covariance + _walk(max(image.time - time, 0.0), len(names))
            wide = wide_calibration(at, walked, used, self.given)
            self.following = Follower(self.given, wide, None if reads else FoundLag(0.0, 0.0), uncertain=True)
            self._reads = reads
        result = self.following.follow(image.time, used, image.seen)
        assert result.covariance is not None
        self._last = image.time, posed(result, names), result.covariance
        if self.following.explained:
            self._unsupported, self._wait = 0, _FIRST_WAIT
        elif image.seen.problem is None:
            self._unsupported += 1
            if self._unsupported >= self._wait and self._found is None:
                self._wait = min(2 * self._wait, self._wait + _MORE_WAIT)
                self._begin_search(image, calibration)
        if reads:
            return result
        read = reading.by_name(names)
        offsets = {name: result.joints[name] - read[name] for name in names if name in read}
        return replace(result, camera_from_base=None, offsets=offsets)


def _solved(image: _Image, given: Followed, calibration: SessionCalibration | None, *, first: bool) -> Result | None:
    """Solve an image by itself; None if nothing is found in it, or its masks are nothing but instrument."""
    readings = replace(image.reading, ecm=None).by_name(given.instrument.joint_names)
    masks = given.segmenter.first_masks(image.seen, readings, guesses=first)
    if not masks:
        return None
    try:
        ignore, config = image.seen.ignored, given.config
        return estimate(masks, given.rig, readings, given.body, ignore=ignore, session=calibration, config=config)
    except InputError:
        return None


def _explains(result: Result, given: Followed) -> bool:
    """Whether the pose of a single frame explains its mask, whatever the readings say."""
    quality, trust, scale = result.quality, given.config.trust, given.rig.camera.pixel_scale
    return quality is not None and not reasons(
        overlap_too_low(quality, trust.least_iou),
        wrist_or_jaws_off(quality, trust.largest_distal_px * scale),
        mask_cut_straight(quality, trust.largest_bend_px * scale),
    )


def _standing(reading: ReadingAt, at: Posed) -> ReadingAt:
    """Return the readings of an arm that stands still, and of joints that are where they were if nothing reads them."""
    joints = np.where(np.isnan(reading.joints), at.joints, reading.joints)
    return ReadingAt(np.zeros(len(OUTER_JOINTS)), joints, np.zeros(len(OUTER_JOINTS)), np.zeros(len(joints)))


def _walk(seconds: float, joints: int) -> Float64:
    """Return the covariance (D, D) of how far an instrument may have moved in a time, s, that nothing reads."""
    step = [_WALK[0]] * 3 + [_WALK[1]] * 2 + [_WALK[2]] * (1 + joints)
    return np.diag(np.square(step) * seconds)
