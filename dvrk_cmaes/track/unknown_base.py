"""Following while no calibration is known: by a wide one, made from a pose of an image that was searched.

A pose tells the base of an arm whose readings are known, up to its own errors and the offsets of roll and joints. Where
nothing is read, the arm is taken to stand still, and the base to walk at random. No pose is ok, since nothing but the
images tells the base.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dvrk_cmaes.calibration.blocks import BASE_AXES, OUTER_OFFSETS, Calibration
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.model import Deviations, SessionModel, offset_deviations
from dvrk_cmaes.calibration.prediction import FoundLag
from dvrk_cmaes.config import TrustConfig
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
from dvrk_cmaes.track.view_segmenter import Mask, Seen

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
    spread = Deviations.of(config.session, names)
    model = SessionModel(
        reading.outer[None], reading.joints[None], names, spread, arm=arm, roll_offset=instrument.roll_offset
    )
    base = np.asarray(at.pose @ inverse(model.base_from_root(offsets)[0]))
    jacobian = model.jacobian(Calibration.of(base, offsets))[0]
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
        spreads=spread.by_name(names),
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
class _Search:
    """The search of an image, its result once it is there, and that image with all that have come since.

    ``first`` is whether nothing was followed before.
    """

    found: Future[Result | None]
    images: list[_Image]
    first: bool


@dataclass(eq=False)
class _Pose:
    """A pose that is followed: where it was at a time, s, with its covariance (D, D), and what follows it.

    ``reads`` is whether readings of a moving arm have stated how it moves since its base was made.
    """

    time: float
    at: Posed
    covariance: Float64
    following: Follower | None = None
    reads: bool = False


@dataclass(eq=False)
class UnknownBase:
    """Searches for an instrument, and follows it while no calibration is known.

    ``background`` is whether a search is done in a thread while the steps after its image go on.
    """

    given: Followed
    background: bool
    _pose: _Pose | None = None
    _search: _Search | None = None
    _unsupported: int = 0
    _wait: int = _FIRST_WAIT

    @property
    def searching(self) -> bool:
        """Whether an image is being searched."""
        return self._search is not None

    @property
    def following(self) -> Follower | None:
        """What follows the pose, at the last image; None without one."""
        return None if self._pose is None else self._pose.following

    def forget(self) -> None:
        """Forget what was followed; the next image is searched."""
        self._pose, self._search = None, None

    def start(self, time: float, result: Result, seen: Seen | None = None, *, widened: float = 1.0) -> None:
        """Follow the pose of a single frame's result from its time, s, on; colours are learned where it is seen.

        ``widened`` is a factor on the standard deviations that the result states.
        """
        assert result.covariance is not None
        self.forget()
        self._pose = _Pose(time, posed(result, self.given.instrument.joint_names), widened**2 * result.covariance)
        self._unsupported, self._wait = 0, _FIRST_WAIT
        if seen is not None:
            self.given.segmenter.learn(seen, self.given.rig.views, self._pose.at)

    def step(
        self, time: float, reading: ReadingAt, seen: Seen, calibration: SessionCalibration | None = None
    ) -> TrackResult:
        """Follow to the image of a later time, s, whose readings, less the lag, are ``reading``.

        A ``calibration`` that cannot be used for want of colours tells where a searched image has the instrument.
        """
        image = _Image(time, reading, seen)
        if self._pose is None and self._search is None:
            if seen.problem is not None:
                return without_pose(time, seen.problem)
            self._begin_search(image, calibration, first=True)
        search, images = self._search, [image]
        if search is not None:
            images = self._go_on(search, image)
        results = [self._follow(each, calibration) for each in images]
        if not results:
            found = NOT_FOUND if self._search is None else search_running(self._search.images[0].time)
            return without_pose(time, found, searched=True)
        return replace(results[-1], searched=search is not None)

    def _begin_search(self, image: _Image, calibration: SessionCalibration | None, *, first: bool) -> None:
        """Begin to search an image."""
        kept, given = replace(image, seen=deepcopy(image.seen)), self.given
        if self.background:
            given = replace(given, config=replace(given.config, threads=1))
        search = partial(_solved, kept, given, calibration, first=first)
        self._search = _Search(_called(search, background=self.background), [kept], first)

    def _go_on(self, search: _Search, image: _Image) -> list[_Image]:
        """Follow what a search has found from its image on; returns the images that are followed in this step.

        So where the instrument is followed to does not depend on how long a search takes.
        """
        images, began = [] if self._pose is None else [image], search.images[0]
        if image.time > began.time:
            search.images.append(replace(image, seen=deepcopy(image.seen)))
        if not search.found.done():
            if len(search.images) > _MOST_IMAGES:
                self._search = None
            return images
        self._search, found = None, search.found.result()
        if found is None or found.camera_from_root is None or found.covariance is None:
            return images
        if search.first or _explains(found, self.given.config.trust, self.given.rig.views[0].camera.pixel_scale):
            self.start(began.time, found, began.seen, widened=_OWN_ERROR)
            return search.images
        return images

    def _follow(self, image: _Image, calibration: SessionCalibration | None) -> TrackResult:
        """Follow the pose to an image; where images do not support it for some time, one is searched."""
        pose, reading, names = self._pose, image.reading, self.given.instrument.joint_names
        assert pose is not None
        reads = reading.has_outer and not reading.still
        used = reading if reads else _standing(reading, pose.at)
        if pose.following is None or not (reads and pose.reads):
            walked = pose.covariance + _walk(max(image.time - pose.time, 0.0), len(names))
            wide = wide_calibration(pose.at, walked, used, self.given)
            pose.following = Follower(self.given, wide, None if reads else FoundLag(0.0, 0.0), uncertain=True)
            pose.reads = reads
        result = pose.following.follow(image.time, used, image.seen)
        assert result.covariance is not None
        pose.time, pose.at, pose.covariance = image.time, posed(result, names), result.covariance
        if pose.following.explained:
            self._unsupported, self._wait = 0, _FIRST_WAIT
        elif image.seen.problem is None:
            self._unsupported += 1
            if self._unsupported >= self._wait and self._search is None:
                self._wait = min(2 * self._wait, self._wait + _MORE_WAIT)
                self._begin_search(image, calibration, first=False)
        if reads:
            return result
        read = reading.by_name(names)
        offsets = {name: result.joints[name] - read[name] for name in names if name in read}
        return replace(result, camera_from_base=None, offsets=offsets)


def _called(function: Callable[[], Result | None], *, background: bool) -> Future[Result | None]:
    """Call a function, in a thread if that is to be done in the background; returns its future value."""
    if background:
        executor = ThreadPoolExecutor(1)
        future = executor.submit(function)
        executor.shutdown(wait=False)  # the thread ends with the function, and the program after it
        return future
    future = Future()
    future.set_result(function())
    return future


def _solved(
    image: _Image,
    given: Followed,
    calibration: SessionCalibration | None,
    *,
    first: bool,
) -> Result | None:
    """Solve an image by itself; None if nothing is found in it, or its masks are nothing but instrument."""
    readings = replace(image.reading, ecm=None).by_name(given.instrument.joint_names)
    masks: Mapping[str, Mask] = given.segmenter.first_masks(image.seen, hinted=first)
    if not masks:
        return None
    try:
        ignored = given.segmenter.ignored(image.seen)
        return estimate(
            masks, given.rig, readings, given.body, ignore=ignored, session=calibration, config=given.config
        )
    except InputError:
        return None


def _explains(result: Result, trust: TrustConfig, pixel_scale: float) -> bool:
    """Whether the pose of a single frame explains its mask, whatever the readings say."""
    quality = result.quality
    return quality is not None and not reasons(
        overlap_too_low(quality, trust.least_iou),
        wrist_or_jaws_off(quality, trust.largest_distal_px * pixel_scale),
        mask_cut_straight(quality, trust.largest_bend_px * pixel_scale),
    )


def _standing(reading: ReadingAt, at: Posed) -> ReadingAt:
    """Return the readings of an arm that stands still, and of joints that are where they were if nothing reads them."""
    joints = np.where(np.isnan(reading.joints), at.joints, reading.joints)
    return ReadingAt(np.zeros(len(OUTER_JOINTS)), joints, np.zeros(len(OUTER_JOINTS)), np.zeros(len(joints)))


def _walk(seconds: float, joints: int) -> Float64:
    """Return the covariance (D, D) of how far an instrument may have moved in a time, s, that nothing reads."""
    step = [_WALK[0]] * 3 + [_WALK[1]] * 2 + [_WALK[2]] * (1 + joints)
    return np.diag(np.square(step) * seconds)
