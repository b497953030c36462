"""The package's version, and the settings of `estimate`: a tree of frozen dataclasses. Every result has both."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field, replace
from typing import Any

__version__ = "2.0.0"


@dataclass(frozen=True)
class Limits:
    """Allowed values of a number among the settings: from ``least`` to ``most``, and zero if ``zero`` is true."""

    least: float = 1e-9
    most: float = 1e6
    zero: bool = False
    share: bool = False

    @property
    def metadata(self) -> dict[str, Limits]:
        """The metadata of a field with these limits; of a table of settings, they are those of all its fields."""
        return {"limits": self}


_SHARE, _SHARE_OR_ZERO = Limits(share=True).metadata, Limits(zero=True, share=True).metadata
_MAY_BE_ZERO = Limits(zero=True).metadata
_OF_ALIKE_MASKS = 2.0  # least factor of `SessionConfig.shared_errors`
_WIDTH = Limits(least=10, most=10_000).metadata


@dataclass(frozen=True)
class ReadingSigmas:
    """Standard deviations of the errors of joint readings, in degrees.

    ``other_deg`` holds for joints of other instruments, whose names have no field of their own.
    """

    wrist_pitch_deg: float = 10.0
    wrist_yaw_deg: float = 10.0
    jaw_deg: float = 15.0
    other_deg: float = 10.0

    def of(self, joint: str) -> float:
        """Return the standard deviation of the reading of a joint, in degrees.

        Parameters
        ----------
        joint
            Name of the joint.
        """
        return float(getattr(self, f"{joint}_deg", self.other_deg))


@dataclass(frozen=True)
class SearchConfig:
    """Settings of the global search.

    Attributes
    ----------
    method
        Optimiser that runs from the starts.
    samples
        Number of random candidate poses that are scored first.
    starts
        Number of distinct best candidates from which the optimiser runs; a quarter are the best of those drawn without
        readings, by the loss without the readings' term, so that the outline can contradict wrong readings.
    evaluations
        Evaluations of the loss by the optimiser, from all starts together.
    width_px
        Approximate width of the images in which losses are computed; up to twice that where the mask is small.
    detail_m
        Cell size of the mesh decimation for small images of the refinement; it is twice this for those of the search.
    use_edges
        Whether candidates are drawn from the shaft's edges in the mask, where these are found.
    free_share
        Fraction of the candidates that are drawn from the LookAt space without using the shaft's edges.
    uniform_joints_share
        Fraction of the candidates whose joints are drawn uniformly within their limits instead of around the readings.
    """

    method: str = "cmaes"
    samples: int = 256
    starts: int = 24
    evaluations: int = 1024
    width_px: int = field(default=80, metadata=_WIDTH)
    detail_m: float = field(default=6e-4, metadata=Limits(least=1e-6).metadata)
    use_edges: bool = True
    free_share: float = field(default=0.15, metadata=_SHARE_OR_ZERO)
    uniform_joints_share: float = 0.25


@dataclass(frozen=True)
class SilhouetteConfig:
    """Settings of the silhouettes in the search of a frame.

    Attributes
    ----------
    method
        How it is decided what the instrument covers between neighbouring crossings of an image line with outline edges:
        ``rays`` traces one ray through the middle, ``count`` counts the layers of faces along the line. Refinement,
        sessions and tracking always count.
    """

    method: str = "rays"


@dataclass(frozen=True)
class LookAtRange:
    """Limits of LookAt candidates.

    The root's z axis points away from the camera, so the magnitudes of the angles alpha and gamma are at most ``tilt``,
    rad, below 90 degrees. The angle beta about the shaft is unlimited. The distance is between ``near`` and ``far``, m;
    it does not limit candidates on the shaft's edges, which have the distance themselves.
    """

    tilt: float = math.radians(80)
    near: float = 0.04
    far: float = 0.4


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms of the loss: lambda 1 to 5 of the paper, and that of the readings.

    They were chosen by hand, and are not decisive: of 108 frames without readings the search found the mode of 82 with
    all terms, and of 84 to 86 without one of mse, dist, scale and cylinder, which the frames' number does not
    distinguish from 82 (data/measurements/frames.md). The twelve best modes by this loss are refined, and the
    refinement does not use these terms.

    Attributes
    ----------
    mse, dist, scale
        Of the silhouette terms, which are divided by the area of the mask.
    cylinder
        Of the shaft's edges.
    keypoints
        Of the jaw tips, per px.
    found_tips
        Factor on ``keypoints`` for jaw tips that were found in the mask instead of given, because these are less
        reliable.
    readings
        Of the squared deviations from readings and joint limits, in standard deviations.
    line_offset
        Weight of the offset of a shaft edge relative to its angle, rad/px.
    """

    mse: float = 1.0
    dist: float = 0.5
    scale: float = 0.3
    cylinder: float = 0.3
    keypoints: float = 0.002
    found_tips: float = 0.2
    readings: float = 0.004
    line_offset: float = 0.005


@dataclass(frozen=True)
class OutlineConfig:
    """Settings of the Gauss-Newton refinement on the outline.

    Attributes
    ----------
    iterations
        Largest number of iterations, each with a silhouette for every pose.
    inner_steps
        Steps of each iteration that need no silhouette: with the robust weights of the previous one, on the residual
        sampled along the outline. At smaller image sizes, whose loss is less robust, a third of these.
    blur
        Standard deviation of the Gaussian blur of coverage and mask, px of the image at the current size.
    lines_per_pixel
        Image lines per pixel row on which the coverage is computed.
    cauchy, small_cauchy, last_cauchy
        Scale of the Cauchy loss, as a difference of coverage: at full image size, at smaller sizes, and in the last
        iterations at full size, in which only segmentation errors leave large residuals.
    correlation
        Length of outline, px, that counts as one independent measurement until the frame's own correlation length is
        estimated.
    noise_floor
        Least standard deviation of the outline, px.
    keypoint_sigma
        Standard deviation of given jaw tips, px.
    tolerance
        Length of a step, in standard deviations per parameter, below which the refinement stops; four times this at
        half the image size, and ten times at smaller ones, from which a refinement at a larger size goes on.
    """

    iterations: int = 20
    inner_steps: int = 6
    blur: float = field(default=1.2, metadata=Limits(most=100).metadata)
    lines_per_pixel: int = field(default=2, metadata=Limits(most=100).metadata)
    cauchy: float = 0.5
    small_cauchy: float = 0.25
    last_cauchy: float = 0.03
    correlation: float = 8.0
    noise_floor: float = field(default=0.15, metadata=_MAY_BE_ZERO)
    keypoint_sigma: float = 2.0
    tolerance: float = 0.05


@dataclass(frozen=True)
class RefineConfig:
    """Settings of the local refinement.

    Attributes
    ----------
    derivatives
        How Gauss-Newton finds the derivatives of outlines: ``closed-form`` follows the outline's points on the surface,
        ``differences`` draws outlines anew after a small change of each unknown, either way.
    width_px
        Approximate width of the images in which what the search found is refined first; they are larger where they
        show little of a mask. The best three modes, with their mirror twins, are refined at full size.
    outline
        Settings of the Gauss-Newton steps.
    """

    derivatives: str = "closed-form"
    width_px: int = field(default=110, metadata=_WIDTH)
    outline: OutlineConfig = field(default_factory=OutlineConfig)


@dataclass(frozen=True)
class CameraConfig:
    """Standard deviations of a camera file that states none, by some pictures of a board, and of the instrument's size.

    Attributes
    ----------
    focal_length_percent, aspect_percent
        Of both focal lengths together, and of fy / fx, %.
    principal_point_percent
        Of each coordinate of the principal point, % of the focal length.
    radial
        Of the first radial coefficient of the distortion.
    instrument_size_percent
        Of the size of the instrument in the images against its model, %; it is added to a file's own covariance.
    """

    focal_length_percent: float = 0.5
    aspect_percent: float = 0.2
    principal_point_percent: float = 0.3
    radial: float = 0.02
    instrument_size_percent: float = 0.1


@dataclass(frozen=True)
class TrustConfig:
    """Thresholds beyond which a result is doubtful.

    The values were set on synthetic frames of all levels and on falsified frames.

    Attributes
    ----------
    tip_mm
        Distance, mm, within which the jaw tips of an ok result probably are of their true positions.
    least_probability
        Least probability that they are.
    least_iou
        Least intersection over union of silhouette and mask.
    largest_distal_px
        Largest root mean square distance of the mask's contour beyond the shaft from the silhouette's outline. Limits
        in px are those of images 640 px wide, and grow with wider ones; this one only for frames that are solved with
        their session or followed.
    largest_bend_px, largest_bend_share
        Largest deviation of the silhouette from a straight line along a straight edge that ends the mask: the larger of
        ``largest_bend_px`` and ``largest_bend_share`` times the width of the shaft in the image.
    largest_outline_gap
        Largest difference of the negative log-likelihood of the outline alone by which another mode may be better.
    largest_reading_sigmas
        Largest deviation of a joint from its reading, in standard deviations of the reading.
    largest_reading_sum
        Largest sum of the squares of these deviations over all joints.
    largest_view_deg, largest_view_sigmas
        Rotation, degrees, by which a view of a stereo pair may contradict the other one, and how many of its standard
        deviations that must be to count.
    largest_base_deg
        Largest rotation, degrees, between a frame's camera_from_base and the most central one of a batch's frames. In a
        batch whose frames scatter more, three times the median rotation counts.
    """

    tip_mm: float = 1.8
    least_probability: float = field(default=0.82, metadata=_SHARE_OR_ZERO)
    least_iou: float = field(default=0.85, metadata=_SHARE_OR_ZERO)
    largest_distal_px: float = 2.8
    largest_bend_px: float = 3.0
    largest_bend_share: float = field(default=0.06, metadata=_SHARE_OR_ZERO)
    largest_outline_gap: float = 2.0
    largest_reading_sigmas: float = 2.8
    largest_reading_sum: float = 7.8
    largest_view_deg: float = 0.1
    largest_view_sigmas: float = 4.0
    largest_base_deg: float = 10.0


@dataclass(frozen=True)
class SessionConfig:
    """Settings of the joint calibration of a session.

    Attributes
    ----------
    arm_deg, insertion_mm, roll_deg, wrist_deg, jaw_deg
        Initial standard deviations of the errors of readings within a session, after subtraction of the session's
        offsets: of the outer yaw and pitch, of insertion, roll, the wrist's joints and the jaw.
    spread_frames
        Weight of these initial values in the estimated variances, as a number of frames.
    arm_std_factor, cable_std_factor
        Largest factors on the initial standard deviations: of the outer yaw and pitch (half of it for insertion), and
        of roll, the wrist's joints and the jaw.
    tail
        Deviation of a joint in one frame, in standard deviations, beyond which its standard deviation is increased in
        that frame.
    slack_mm, slack_deg
        Standard deviations of the root's position along each axis and its rotation about each axis that no joint
        explains.
    insertion_offset_mm, roll_offset_deg
        Standard deviations of the offsets of insertion and roll. Those of the instrument's joints are the standard
        deviations of their readings, ``readings``.
    cauchy
        Scale of the Cauchy loss of the outline, as a difference of coverage.
    largest_misfit
        Squared misfit per degree of freedom above which a frame disagrees with the session. A new frame below it, whose
        mask the predicted pose explains, is not searched globally.
    cables
        Whether coupling, play and wander of the cables are estimated, in addition to the offsets.
    shadows
        Whether stretches of a mask that lie off the silhouette of a fit count less the farther off they are, as where a
        shadow beside the shaft was taken for it. Keyframes of a recording that is followed as it comes always do.
    alike_seconds
        Time in which consecutive frames err alike, s, so that all of them count as one in base, offsets, camera, margin
        and the error of the lag; 0 to count each.
    shared_errors
        Factor on the standard deviations of what the frames show of camera and lens, because they share errors of masks
        and meshes; at least 2 where this program found the masks in images.
    test_camera
        Whether the frames test the camera file, which takes a quarter of the time. Keyframes of a recording that is
        followed as it comes do so only once as many as are kept have been solved.
    """

    arm_deg: float = 0.1
    insertion_mm: float = 0.4
    roll_deg: float = 3.0
    wrist_deg: float = 3.5
    jaw_deg: float = 5.0
    spread_frames: float = 1.0
    arm_std_factor: float = 5.0
    cable_std_factor: float = 1.5
    tail: float = 2.0
    slack_mm: float = 0.2
    slack_deg: float = 0.1
    insertion_offset_mm: float = 0.5
    roll_offset_deg: float = 20.0
    cauchy: float = 0.25
    largest_misfit: float = 12.0
    cables: bool = True
    shadows: bool = False
    alike_seconds: float = field(default=0.5, metadata=_MAY_BE_ZERO)
    shared_errors: float = 1.2
    test_camera: bool = True


@dataclass(frozen=True)
class TrackConfig:
    """Settings of the tracker.

    Attributes
    ----------
    lag_std
        Standard deviation of the lag at the start, s, if it is not given.
    black_level
        Value of the brightest pixel below which an image counts as black.
    colour_share
        Share of an image's colours in those that were learned, each time that they are learned anew.
    frames_a_second
        Frames a second of a session whose images have no times.
    reading_gap, still_seconds
        Longest time between readings, s, over which they are interpolated; time after which unchanged readings of all
        outer joints count as frozen.
    """

    lag_std: float = 0.1
    black_level: int = 16
    colour_share: float = 0.15
    frames_a_second: float = 30.0
    reading_gap: float = 0.15
    still_seconds: float = 0.25


@dataclass(frozen=True)
class EstimateConfig:
    """All settings of `estimate`.

    Attributes
    ----------
    silhouette, search, refine, weights, readings, lookat, camera, trust, session, track
        Settings of the single stages.
    distance_field
        Method of the distance field: ``fmm``, ``exact`` or ``chamfer``.
    decay_px
        Distance, px, over which the distance field of the loss increases by one.
    threads
        Number of threads. More than one is faster only for large images; with the small images of the search, threads
        wait for Python's global interpreter lock. To use several cores for many frames, run several processes.
    seed
        Seed of all random numbers.
    """

    silhouette: SilhouetteConfig = field(default_factory=SilhouetteConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    weights: LossWeights = field(default_factory=LossWeights, metadata=_MAY_BE_ZERO)
    readings: ReadingSigmas = field(default_factory=ReadingSigmas)
    lookat: LookAtRange = field(default_factory=LookAtRange)
    camera: CameraConfig = field(default_factory=CameraConfig, metadata=_MAY_BE_ZERO)
    trust: TrustConfig = field(default_factory=TrustConfig, metadata=_MAY_BE_ZERO)
    session: SessionConfig = field(default_factory=SessionConfig)
    track: TrackConfig = field(default_factory=TrackConfig)
    distance_field: str = "fmm"
    decay_px: float = 30.0
    threads: int = field(default=1, metadata=Limits(most=1000).metadata)
    seed: int = field(default=0, metadata=Limits(most=2**32 - 1, zero=True).metadata)

    def as_dict(self) -> dict[str, Any]:
        """Return all settings as nested dictionaries."""
        return _as_dict(self)

    def with_alike_masks(self) -> EstimateConfig:
        """Return the settings for a session whose masks this program found in images, which err more alike."""
        shared = max(self.session.shared_errors, _OF_ALIKE_MASKS)
        return replace(self, session=replace(self.session, shared_errors=shared))


def _as_dict(tree: Any) -> dict[str, Any]:
    """Return nested dataclasses as dictionaries; `dataclasses.asdict` copies each value, which takes longer."""
    return {key: _as_dict(value) if dataclasses.is_dataclass(value) else value for key, value in vars(tree).items()}


REMOVED = {
    "search.unread_share": "see search.uniform_joints_share",
    "session.arm_growth": "see session.arm_std_factor",
    "session.cable_growth": "see session.cable_std_factor",
    "session.rounds": "frames and session are solved in three rounds",
    "session.loosened": "frames are fitted with what their session expects as it is, in all rounds",
    "session.turn_deg": "frames that disagree start from what their session expects, too",
    "session.masks_again": "masks stay as `batch` found them",
    "track.modes": "the most probable mode is followed",
    "track.points": "masks are found in images, and all of their contour counts",
    "session.focal_length_percent": "see camera.focal_length_percent",
    "session.principal_point_px": "see camera.principal_point_percent, of the focal length",
    **dict.fromkeys(("search.screened", "search.screen_shrink", "search.screen_detail_m"), "see search.samples"),
    **dict.fromkeys(("search.spares", "search.unread_spares"), "see search.starts"),
    **dict.fromkeys(("refine.method", "refine.evaluations"), "see refine.derivatives, or search.method of NLopt's"),
    **dict.fromkeys([f"refine.first_{name}" for name in ("steps", "candidates", "gap")], "see search.starts"),
    **dict.fromkeys([f"refine.small_{name}" for name in ("modes", "steps", "share", "gap")], "see search.starts"),
    **dict.fromkeys([f"refine.{name}" for name in ("agreed_gap", "last_share", "last_gap")], "see search.starts"),
    **dict.fromkeys([f"refine.{name}" for name in ("half_size_modes", "modes", "full_steps")], "see search.starts"),
}
"""Settings of earlier versions, and what there is in their place."""
