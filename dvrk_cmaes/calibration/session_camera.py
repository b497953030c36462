"""What a session's frames tell about its camera: the change they fit, and whether they contradict the camera file.

The change has three unknowns: the logarithm of the focal length's factor and the shift of the principal point, px. It
is estimated beside the margin of the masks, which makes the shaft wider as a longer focal length does. A single frame
hardly determines it, because a change of its pose has nearly the same effect. In a session, the arm's kinematics fix
the distances between the remote centre of motion and the wrists, and thereby the scale along the optical axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, FoundBlock, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.consensus import evenly_spaced
from dvrk_cmaes.calibration.lasting_errors import CommonErrors, frames_alike
from dvrk_cmaes.calibration.linearise import (
    NAMED,
    PASSES,
    SHARED_ERRORS,
    FramesAt,
    Linearised,
    SessionOutlines,
    inverse_information,
    linearise,
)
from dvrk_cmaes.calibration.mask_growth import GROWTH, GrowthEstimate, MaskGrowth, estimate_growth
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_shaft import SIZES, SessionShaft
from dvrk_cmaes.calibration.solve import cost_at, solve
from dvrk_cmaes.calibration.stored_frame import changed
from dvrk_cmaes.calibration.variances import solve_with_variances
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.critical import FILE
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Count, Number
from dvrk_cmaes.pose.terms.coverage import of_camera

CAMERA = "camera"
"""Name of the block."""

HINT = "the camera file may be wrong"
"""What the remark begins with where the frames fit another camera better, without being sure of it."""

_WEAK_STD = np.array([0.3, 300.0, 300.0])  # of the change where it is estimated from the frames: relative, and px
PLAUSIBLE = 2.0  # of these; linearised farther away, outlines leave the image
_STEPS = 10  # largest number of Gauss-Newton steps between two estimates of the variances
_LEAST_FRAMES, _MANY_FRAMES = 6, 10
_LEAST_INSERTION = 5e-3  # m, range of the readings
_CONTRADICTION = 11.34  # squared Mahalanobis distance from no change; that of 99 % with three unknowns
_CLEAR_CONTRADICTION = 16.27  # that of 99.9 %, where the frames are fewer than ``_MANY_FRAMES``
_LEAST_GAIN, _HINT_GAIN = 9.84, 3.84
"""By how much less the sum of squares must be with another camera than the file's: to contradict it, and for a remark.

The first is that of 98 % with three unknowns, and the least squared distance from no change, too, where it is a remark.
Where frames near each other count as one, the distance alone tells right files from focal lengths that are 10 % off:
`scripts/measure.py calibrate` on recordings of `fleet.py make`, seeds 8613 to 8618, 8707 to 8710, 8807 to
8810 and 8907 to 8909: at most 6 and, but for one that is 4, at least 15.
"""
_ALIKE_SECONDS = SessionConfig().alike_seconds
IMPLAUSIBLE = (
    "camera: its estimate from these frames is not plausible; frames with other poses of the arm, above all another "
    "insertion, tell it better"
)
"""Why a session does not tell its camera: the estimate lies too far away for outlines that were linearised here."""

_NOT_ASKED = "camera: not tested, as the settings say"
_CAUSES = (
    "a calibration of another zoom, focus, endoscope or crop of the image, or --rectified left out; a tool or arm of "
    "another length has a similar effect"
)


class CameraChange(SeenBlock):
    """The change (3,) of all cameras: by default, nothing is known of it beforehand; arguments as of `SeenBlock`."""

    def __init__(self, std: Float64 | None = None, start: Float64 | None = None) -> None:
        super().__init__(CAMERA, _WEAK_STD if std is None else std, start)

    def is_plausible(self, values: Float64) -> bool:
        """Whether the outlines are not likely to have left the image."""
        return bool((np.abs(values) < PLAUSIBLE * _WEAK_STD).all())

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view with the changed camera."""
        return replace(by, camera=changed(by.camera, values * [1.0, by.size, by.size]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the change."""
        return of_camera(outline.view, outline.points) * [1.0, outline.size, outline.size]


@dataclass(frozen=True)
class SessionCamera(Document):
    """Change of the camera that a session's frames fit, with standard deviations.

    focal_scale : factor on the focal lengths of the camera file.
    principal_point_px : shift of the principal point, px to the right and down, in images of ``width`` px.
    contradicts : whether the frames contradict the camera file. If they do, the values are what the frames alone fit;
        otherwise the file counts as a measurement with the configured standard deviations.
    applied : whether the session was solved with the changed camera; then the values are what the frames alone fit.
    """

    focal_scale: Number
    std_focal_scale: Number
    principal_point_px: tuple[Number, Number]
    std_principal_point_px: tuple[Number, Number]
    contradicts: bool
    applied: bool
    width: Count

    @classmethod
    def of(
        cls,
        estimate: CameraEstimate,
        config: SessionConfig,
        width: int,
        *,
        applied: bool,
        frames: int,
        unusual: bool = False,
    ) -> SessionCamera:
        """Decide whether an estimate from some frames contradicts the camera file, and state it.

        Each linearisation may be farther away than the one before. What the frames tell at the camera of the file must
        contradict it as well. Unless the file is ``unusual`` in itself, few frames must contradict it clearly, and
        another camera must explain the frames better.
        """
        change, covariance = estimate.change, SHARED_ERRORS**2 * estimate.covariance
        limit = _CONTRADICTION if unusual or applied or frames >= _MANY_FRAMES else _CLEAR_CONTRADICTION
        contradicts = _distance(change, covariance, config) > limit
        if not applied:
            first = _distance(estimate.first_change, SHARED_ERRORS**2 * estimate.first_covariance, config)
            contradicts = contradicts and first > limit and (unusual or estimate.gain >= _LEAST_GAIN)
        if not (contradicts or applied):
            change, covariance = _with_file(change, covariance, config)
        return cls.at(change, covariance, width, contradicts=contradicts, applied=applied)

    @classmethod
    def at(cls, change: Float64, covariance: Float64, width: int, *, contradicts: bool, applied: bool) -> SessionCamera:
        """State a change (3,) with its covariance (3, 3), of images of some width, px."""
        scale, std = float(np.exp(change[0])), np.sqrt(np.diag(covariance))
        return cls(
            focal_scale=scale,
            std_focal_scale=scale * float(std[0]),
            principal_point_px=(float(change[1]), float(change[2])),
            std_principal_point_px=(float(std[1]), float(std[2])),
            contradicts=contradicts,
            applied=applied,
            width=width,
        )

    def corrected(self, camera: Camera) -> Camera:
        """Return the camera of the file with the change, for images of any size; unchanged if it was not applied.

        Parameters
        ----------
        camera
            The camera of the file, or one of the same image at another size.
        """
        if not self.applied:
            return camera
        size = camera.width / self.width
        right, down = self.principal_point_px
        return camera.changed(self.focal_scale, (size * right, size * down))

    def describe(self) -> str:
        """Describe the change in words, with standard deviations."""
        (right, down), (std_right, std_down) = self.principal_point_px, self.std_principal_point_px
        return (
            f"focal length {100 * (self.focal_scale - 1):+z.1f} % (std {100 * self.std_focal_scale:.1f}), principal "
            f"point {right:+z.0f} px right (std {std_right:.0f}), {down:+z.0f} px down (std {std_down:.0f})"
        )

    def of_the_camera_found(self) -> SessionCamera:
        """Return what is known of the camera that was found, where that takes the place of a camera's file."""
        return replace(
            self,
            focal_scale=1.0,
            std_focal_scale=self.std_focal_scale / self.focal_scale,
            principal_point_px=(0.0, 0.0),
            contradicts=False,
        )

    def describe_found(self, guess: Camera) -> str:
        """Describe the camera that was found without a file, and what would tell it better.

        Parameters
        ----------
        guess
            The camera that was guessed, for images of any size.
        """
        found, size = self.corrected(guess), guess.width / self.width
        std = found.fx * self.std_focal_scale / self.focal_scale
        across, down = (size * each for each in self.std_principal_point_px)
        return (
            f"no camera file: these frames tell a focal length of {found.fx:.0f} px (std {std:.0f}) and a principal "
            f"point at {found.cx:.0f}, {found.cy:.0f} px (std {across:.0f}, {down:.0f}), without lens distortion. A "
            "checkerboard in some 20 pictures tells all of these better (camera_calibration of ROS), a longer "
            "recording in which insertion moves by some centimetres the focal length"
        )

    def contradictions(self, config: SessionConfig) -> list[str]:
        """Describe what of the camera file the frames contradict, with likely causes; empty if they do not.

        Parameters
        ----------
        config
            Settings of calibrations.
        """
        if not self.contradicts:
            return []
        file_std = file_deviations(config)
        scale, std = self.focal_scale - 1, self.std_focal_scale
        shift, std_shift = np.array(self.principal_point_px), np.array(self.std_principal_point_px)
        of_focal_length = abs(scale) > NAMED * np.hypot(std, file_std[0])
        of_centre = bool((np.abs(shift) > NAMED * np.hypot(std_shift, file_std[1:])).any())
        parts = []
        if of_focal_length or not of_centre:
            than = "longer" if scale > 0 else "shorter"
            parts.append(f"a focal length {100 * abs(scale):.1f} % (std {100 * std:.1f}) {than}")
        if of_centre or not of_focal_length:
            across, down = "right" if shift[0] > 0 else "left", "down" if shift[1] > 0 else "up"
            parts.append(
                f"a principal point {abs(shift[0]):.0f} px (std {std_shift[0]:.0f}) {across} and "
                f"{abs(shift[1]):.0f} px (std {std_shift[1]:.0f}) {down}"
            )
        then = "which is used" if self.applied else f"likely causes: {_CAUSES}"
        return [f"the camera file is contradicted: these frames fit {' and '.join(parts)}; {then}"]


def covariance_of_camera(change: SessionCamera | None, at: Posed, camera: Camera) -> Float64:
    """Return the covariance (D, D) of a pose and its joints by what is not known of a camera that was changed.

    The image stays as it is: a shift of the principal point turns the pose about the camera's centre, and a longer
    focal length moves it away in proportion. It is zero where the camera of the file is used.

    Parameters
    ----------
    change
        The change of a session's camera; None where it was not tested.
    at
        Pose and joints in the changed camera.
    camera
        That camera, for images of any size.
    """
    covariance = np.zeros((6 + len(at.joints),) * 2)
    if change is None or not change.applied:
        return covariance
    x, y, z = at.pose[:3, 3]
    rotation = np.array([[y / z, 0.0, 1 / camera.fy], [-x / z, -1 / camera.fx, 0.0], [0.0, 0.0, 0.0]])
    translation = np.cross(rotation.T, at.pose[:3, 3]).T
    translation[:, 0] = 0.0, 0.0, z
    size = camera.width / change.width
    std = [change.std_focal_scale / change.focal_scale, *(size * np.array(change.std_principal_point_px))]
    moves = np.concatenate([at.pose[:3, :3].T @ translation, at.pose[:3, :3].T @ rotation]) * std
    covariance[:6, :6] = moves @ moves.T
    return covariance


def camera_undetermined(model: SessionModel) -> str | None:
    """Say why a session cannot tell its camera; None if it can."""
    return _lacking(model, _MANY_FRAMES, "tell")


def _lacking(model: SessionModel, least: int, purpose: str) -> str | None:
    frames, spread = len(model.outer), float(np.ptp(model.outer[:, 2]))
    if frames < least:
        return f"camera: {frames} frames; at least {least} are needed to {purpose} its focal length"
    if spread < _LEAST_INSERTION:
        return (
            f"camera: insertion moves by {spread * 1e3:.1f} mm; at least {_LEAST_INSERTION * 1e3:.0f} mm are needed to "
            f"{purpose} its focal length"
        )
    return None


@dataclass(frozen=True, eq=False)
class CameraCheck:
    """What a session's frames tell about the camera, and what errors of the camera do to the calibration.

    ``camera`` is None where the session does not test it, and ``undetermined`` then says why. ``covariance`` (K, K) is
    the mean square of the calibration's errors, in the order of `SessionModel.axes`, that errors of the camera cause.
    ``growth`` and ``shaft`` are what the outlines tell of errors of the masks on some sides, beside the camera, and of
    the radius of the shaft, with the camera of the file; None where the camera cannot be changed. ``blocks`` are what
    is found of those that state themselves (`SeenBlock.stated`). ``hint`` is as of
    `CameraEstimate.hint`, empty where the file is contradicted or not used.
    """

    camera: SessionCamera | None
    undetermined: str
    covariance: Float64
    growth: GrowthEstimate | None = None
    shaft: SessionShaft | None = None
    blocks: Mapping[str, FoundBlock] = field(default_factory=dict)
    hint: str = ""


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """The change (3,) of the camera that a session's frames fit best, and the calibration with it.

    ``covariance`` (3, 3) is that of the change, of which hardly anything is known beforehand. ``sensitivity`` (K, 3) is
    the derivative of the calibration, in the order of `SessionModel.axes`, by the change. ``at`` are the poses of the N
    frames with the changed camera. ``plausible`` is as in `Linearised`. ``first_change`` (3,) and ``first_covariance``
    (3, 3) are what the first linearisation told, at the start, and ``gain`` is by how much less its sum of squares is
    with any camera than with one that the file expects. ``growth`` and ``shaft`` are what the last one told of errors
    of the masks on some sides, and of the shaft's radius; None if they are not among the blocks. ``blocks`` are those
    that state themselves, ``of_blocks`` (K, K) the mean square of the calibration's errors that their errors cause.
    """

    change: Float64
    covariance: Float64
    first_change: Float64
    first_covariance: Float64
    sensitivity: Float64
    calibration: Calibration
    at: Posed
    plausible: bool = True
    gain: float = np.inf
    growth: GrowthEstimate | None = None
    shaft: SessionShaft | None = None
    blocks: Mapping[str, FoundBlock] = field(default_factory=dict)
    of_blocks: Float64 | float = 0.0

    def hint(self, width: int, common: CommonErrors) -> str:
        """Say that the frames fit another camera better, without being sure of it; empty if they do not.

        Of n frames of half a second, counted as one, what they tell of the camera is stated too widely, counted as n
        too narrowly, both by some factor of n^(1/4): in 17 recordings by 1.9, in 75 by 1/1.9, with n of 8 and 9.

        Parameters
        ----------
        width
            That of the images, px.
        common
            The errors that the frames share.
        """
        near = float(np.median(frames_alike(common.times, _ALIKE_SECONDS))) ** 0.5
        as_one = common.alike_seconds > 0
        covariance = SHARED_ERRORS**2 * self.covariance
        distance = float(self.change @ np.linalg.solve(covariance, self.change)) * (near if as_one else 1 / near)
        if distance < _LEAST_GAIN or not (as_one or self.gain >= _HINT_GAIN):
            return ""
        other = SessionCamera.at(self.change, covariance, width, contradicts=False, applied=False)
        return (
            f"{HINT}: these frames fit another one better ({other.describe()}), but do not tell it for sure; frames "
            "with other insertions of the arm do"
        )


def estimate_camera(
    frames: FramesAt, config: SessionConfig, outlines: SessionOutlines, *, passes: int
) -> CameraEstimate:
    """Estimate the change of the camera beside the calibration.

    Arguments are as in `linearise`; the ``outlines`` are those of the reference camera, with the change among their
    blocks. ``config`` has the settings of the variance components, which are estimated again with the change.
    """
    solver = partial(solve_with_variances, config=config, steps=_STEPS)
    there = linearise(frames, outlines, solver, [CAMERA], passes=passes)
    first, own = there.first or there, there.solution.calibration.place(CAMERA)
    count, information = frames.calibration.alone().own, there.information
    told = [(one.value(CAMERA), one.covariance[own, own]) for one in (there, first)]
    growth, shaft = None, None
    of_masks = next((one for one in outlines.blocks if isinstance(one, MaskGrowth)), None)
    if of_masks is not None:
        changed_camera = any(one.name == CAMERA and one.start.any() for one in outlines.blocks)
        beside = {} if changed_camera else {CAMERA: file_deviations(config)}
        each = (there,) if first is there else (there, first)
        known = [estimate_growth(one, of_masks, beside) for one in each]
        told = [(one.values[own], one.covariance[own, own]) for one in (known[0], known[-1])]
        # the file's camera is nearest to what was linearised first, about it; the last one has all frames
        growth = replace(known[-1], of_frames=known[0].of_frames)
        if any(one.name == SIZES for one in outlines.blocks):
            shaft = SessionShaft.of(there, {CAMERA: file_deviations(config), GROWTH: growth.std_px})
    return CameraEstimate(
        *told[0],
        *told[1],
        -inverse_information(information[:count, :count]) @ information[:count, own],
        there.solution.calibration.alone(),
        there.at,
        there.plausible,
        _gain_of_any_camera(frames.model, frames.calibration.alone(), first, config),
        growth,
        shaft,
        *_stated(there, outlines.blocks, {} if growth is None else {GROWTH: growth.std_px}, config),
    )


def _stated(
    there: Linearised, blocks: Sequence[SeenBlock], known: Mapping[str, Float64], config: SessionConfig
) -> tuple[dict[str, FoundBlock], Float64]:
    """State what is found of the blocks that state themselves, beside a camera that is known as its file is.

    ``known`` are standard deviations beforehand of other blocks. Also returns the mean square (K, K) of the
    calibration's errors that their errors cause, which are not corrected.
    """
    calibration, count = there.solution.calibration, there.solution.calibration.own
    values, covariance = there.with_std({CAMERA: file_deviations(config), **known})
    found, of_blocks = dict[str, FoundBlock](), np.zeros((count, count))
    for block in blocks:
        place = calibration.place(block.name)
        spread = SHARED_ERRORS**2 * covariance[place, place]
        if (stated := block.stated(values[place], np.sqrt(np.diag(spread)))) is not None:
            found[block.name] = stated
            moves = -inverse_information(there.information[:count, :count]) @ there.information[:count, place]
            of_blocks += moves @ (spread + np.outer(values[place], values[place])) @ moves.T
    return found, of_blocks


def _gain_of_any_camera(
    model: SessionModel, calibration: Calibration, first: Linearised, config: SessionConfig
) -> float:
    """Return by how much less the frames' sum of squares is with any camera than with one that the file expects.

    Far from the camera of the file, the covariance of an estimate says little about how well the file explains the
    frames. Variances and weights are those of the session with the file. Arguments are as in `estimate_camera`;
    ``first`` is the linearisation at the start.
    """
    if len(first.at) != len(model.outer):
        model = model.subset(evenly_spaced(len(model.outer), len(first.at)))
    seen = first.solution.calibration.blocks[calibration.own_blocks :]
    zero = {block.name: np.zeros(len(block.std)) for block in seen}
    start = calibration.beside(*seen, **zero)
    (any_camera,) = (block for block in seen if block.name == CAMERA)
    known = CameraChange((any_camera.std**-2 + file_deviations(config) ** -2) ** -0.5)
    by_file, by_any = (solve(model, first.fits, one) for one in (start.beside(known, **zero), start))
    costs = [cost_at(model, first.fits, one.calibration, by_file.weights) for one in (by_file, by_any)]
    return costs[0] - costs[1]


def check_camera(
    frames: FramesAt, config: SessionConfig, outlines: SessionOutlines, *, applied: Float64 | None = None
) -> CameraCheck:
    """Test the camera of a calibrated session.

    ``applied`` is the change (3,) of the camera with which the frames were fitted, with which the block starts; None
    if they were fitted with the file's. The other arguments are as in `estimate_camera`. Where an estimate is not
    plausible, only what the frames tell at the camera of the file is left, which may contradict it or say nothing.
    """
    reason = _lacking(frames.model, _LEAST_FRAMES, "test") if config.test_camera or applied is not None else _NOT_ASKED
    passes = PASSES[CAMERA] if reason is None and applied is None else 1
    try:
        estimate = estimate_camera(frames, config, outlines, passes=passes)
        if far := passes > 1 and not estimate.plausible:
            estimate = estimate_camera(frames, config, outlines, passes=1)
    except InputError as error:
        return CameraCheck(None, f"camera: {error}", np.zeros((frames.calibration.alone().own,) * 2))
    if applied is not None:
        estimate = replace(estimate, change=applied)
    camera = SessionCamera.of(
        estimate,
        config,
        outlines.camera.width,
        applied=applied is not None,
        frames=len(frames.at),
        unusual=any(text.startswith(FILE) for text in outlines.camera.remarks),
    )
    if far and not camera.contradicts:
        reason = IMPLAUSIBLE
    covariance = _of_camera(estimate, config, tested=reason is None, applied=applied is not None) + estimate.of_blocks
    if reason is not None:
        return CameraCheck(None, reason, covariance, estimate.growth, estimate.shaft, estimate.blocks)
    hint = "" if camera.applied or camera.contradicts else estimate.hint(camera.width, outlines.common)
    return CameraCheck(camera, "", covariance, estimate.growth, estimate.shaft, estimate.blocks, hint)


def _of_camera(estimate: CameraEstimate, config: SessionConfig, *, tested: bool, applied: bool) -> Float64:
    """Return the mean square (K, K) of the calibration's errors that errors of the camera cause.

    If the frames do not test the camera, its errors are those expected of its file. Otherwise they are what frames and
    file together tell: the mean error, whose effect is not corrected unless the change is applied, and its covariance.
    """
    if not tested:
        square = np.diag(file_deviations(config) ** 2)
    elif applied:
        square = SHARED_ERRORS**2 * estimate.covariance
    else:
        change, covariance = _with_file(estimate.change, SHARED_ERRORS**2 * estimate.covariance, config)
        square = covariance + np.outer(change, change)
    return np.asarray(estimate.sensitivity @ square @ estimate.sensitivity.T)


def _distance(change: Float64, covariance: Float64, config: SessionConfig) -> float:
    """Return the squared Mahalanobis distance of a change (3,) from the camera file, whose errors count as well."""
    return float(change @ np.linalg.solve(covariance + np.diag(file_deviations(config) ** 2), change))


def _with_file(change: Float64, covariance: Float64, config: SessionConfig) -> tuple[Float64, Float64]:
    """Return a change (3,) and its covariance (3, 3) with the camera file as a measurement that says: no change."""
    file_covariance = np.diag(file_deviations(config) ** 2)
    gain = file_covariance @ np.linalg.inv(covariance + file_covariance)
    return gain @ change, gain @ covariance


def file_deviations(config: SessionConfig) -> Float64:
    """Return the standard deviations (3,) of the camera file: of its focal length, relative, and its centre, px."""
    return np.array([config.focal_length_percent / 100, config.principal_point_px, config.principal_point_px])
