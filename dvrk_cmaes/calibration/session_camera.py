"""What a session's frames determine of its camera: the change they fit, and whether they contradict the camera file.

The change has three unknowns: the logarithm of the focal length's factor and the shift of the principal point, px. It
is estimated with the margin of the masks, which makes the shaft wider as a longer focal length does. A single frame
hardly determines it, because a change of its pose has nearly the same effect. In a session, the arm's kinematics fix
the distances between the remote centre of motion and the wrists, and thereby the scale along the optical axis.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import CLEAR, FoundBlock, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import (
    NAMED,
    ArmOutlines,
    Linearised,
    linearise,
)
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_frame import changed
from dvrk_cmaes.calibration.session_masks import MarginEffect
from dvrk_cmaes.calibration.session_shaft import SIZES, found_sizes, square_of_whole, usual_sizes
from dvrk_cmaes.calibration.solve import inverse_information
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.lens import COEFFICIENT_COUNTS
from dvrk_cmaes.config import CameraConfig, EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Count, Number
from dvrk_cmaes.pose.expected_error import PARAMETERS, displacements, file_covariance
from dvrk_cmaes.pose.terms.coverage import of_camera

CAMERA, LENS = "camera", "lens"
"""Names of the blocks."""

TESTED = [PARAMETERS.index(name) for name in ("focal_length", "centre_right", "centre_down")]
"""Which of the parameters of a camera are the three unknowns."""
_OF_LENS: Final = [PARAMETERS.index("aspect"), PARAMETERS.index("radial")]
_LENS_CAUSES: Final = "images that were stretched, --rectified with raw images or left out, or the file of another lens"
_WEAK_STD = np.array([0.3, 300.0, 300.0])  # of the change where it is estimated from the frames: relative, and px
PLAUSIBLE = 2.0  # of these; linearised farther away, outlines leave the image
_PASSES, _FILE_PASSES = 6, 3  # largest numbers of linearisations of the outlines, also where the file is a measurement
_LEAST_FRAMES, _MANY_FRAMES = 6, 10
_LEAST_INSERTION = 5e-3  # m, range of the readings
_CONTRADICTION = 16.27  # squared distance from no change, of 99.9 % with three unknowns
_WRONG_SHARE, _WRONG_STD = 0.05, 10.0
"""Share of files of another zoom, crop or endoscope, as far as frames could show it, and their errors in usual ones."""
IMPLAUSIBLE = (
    "camera: its estimate from these frames is not plausible; frames with other poses of the arm, above all another "
    "insertion, determine it better"
)
"""Why a session does not determine its camera: the estimate is too far away for outlines that were linearised here."""

_LENS_PLAUSIBLE = (0.5, 3.0)  # of both errors of a lens; outlines that were linearised say nothing of larger ones
_NOT_ASKED = "camera: not tested, as the settings say"
_CAUSES = (
    "a calibration of another zoom, focus, endoscope or crop of the image, or --rectified left out; a tool or arm of "
    "another length has a similar effect"
)


class CameraChange(SeenBlock):
    """The change (3,) of all cameras: by default, nothing is known of it beforehand; arguments as of `SeenBlock`."""

    shared = True

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


class Lens(SeenBlock):
    """The errors (2,) of a camera file: of log (fy / fx), and of the first radial coefficient."""

    is_linear = True

    def __init__(self, config: EstimateConfig, camera: Camera) -> None:
        super().__init__(LENS, np.sqrt(np.diag(file_covariance(camera, config.camera)))[_OF_LENS])
        self.axes, self._shared = ("aspect", "radial"), config.session.shared_errors

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view with another aspect and radial coefficient."""
        if not values.any():
            return by
        camera, (aspect, radial) = by.camera, values
        first, *others = camera.distortion or (0.0,) * COEFFICIENT_COUNTS[camera.model][-1]
        focal = camera.fx * np.exp(-aspect / 2), camera.fy * np.exp(aspect / 2)
        return replace(by, camera=replace(camera, fx=focal[0], fy=focal[1], distortion=(first + radial, *others)))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by both."""
        camera, pixels = outline.view.camera, outline.points.pixels
        moved = displacements(camera, pixels, camera.normalise(pixels))[:, :, _OF_LENS]
        return np.asarray(np.einsum("nk,nkp->np", outline.points.normals, moved))

    def stated(self, values: Float64, std: Float64) -> FoundBlock:
        """State both, and what the frames alone show of them where that contradicts the file."""
        gained = np.maximum(std**-2 - self.std**-2, 1e-12)
        alone, spread = values * (1 + self.std**-2 / (self._shared**2 * gained)), 1 / np.sqrt(gained)
        off = np.where(np.abs(alone) < _LENS_PLAUSIBLE, np.abs(alone) / np.hypot(spread, self.std), 0.0)
        texts = [
            f"fy / fx {100 * alone[0]:+z.1f} % (std {100 * spread[0]:.1f}) off",
            f"a radial coefficient {alone[1]:+z.2f} (std {spread[1]:.2f}) off",
        ]
        clear = [text for text, far in zip(texts, off, strict=True) if far > CLEAR]
        doubt = (
            f"the camera file is contradicted: these frames fit {' and '.join(clear)}; likely causes: {_LENS_CAUSES}"
        )
        stated = f"lens: fy / fx {100 * values[0]:+z.2f} % (std {100 * std[0]:.2f}), radial {values[1]:+z.3f}"
        each = (tuple(one.tolist()) for one in (values, std, self.std))
        given, known, file = each
        return FoundBlock(self.axes, given, known, file, f"{stated} (std {std[1]:.3f})", doubt if clear else "")


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
    def of(cls, change: Float64, covariance: Float64, file: Float64, width: int, *, applied: bool) -> SessionCamera:
        """Decide whether the change (3,) that some frames fit, with its covariance, contradicts the camera file.

        ``file`` (3,) are the standard deviations of the file, as of `file_deviations`.
        """
        contradicts = _distance(change, covariance, file) > _CONTRADICTION
        if not (contradicts or applied):
            change, covariance = _with_file(change, covariance, file)
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
        """Describe the camera that was found without a file, and what would determine it better.

        Parameters
        ----------
        guess
            The camera that was guessed, for images of any size.
        """
        found, size = self.corrected(guess), guess.width / self.width
        std = found.fx * self.std_focal_scale / self.focal_scale
        across, down = (size * each for each in self.std_principal_point_px)
        return (
            f"no camera file: these frames determine a focal length of {found.fx:.0f} px (std {std:.0f}) and a "
            f"principal point at {found.cx:.0f}, {found.cy:.0f} px (std {across:.0f}, {down:.0f}), without lens "
            "distortion. A checkerboard in some 20 pictures determines all of these better (camera_calibration of "
            "ROS), a longer recording in which insertion moves by some centimetres the focal length"
        )

    def contradictions(self) -> list[str]:
        """Describe what of the camera file the frames contradict, with likely causes; empty if they do not."""
        if not self.contradicts:
            return []
        scale, std = self.focal_scale - 1, self.std_focal_scale
        shift, std_shift = np.array(self.principal_point_px), np.array(self.std_principal_point_px)
        file = CameraConfig()
        of_focal_length = abs(scale) > NAMED * np.hypot(std, file.focal_length_percent / 100)
        of_centre = bool(
            (np.abs(shift) > NAMED * np.hypot(std_shift, file.principal_point_percent / 100 * self.width)).any()
        )
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


def camera_undetermined(model: SessionModel) -> str | None:
    """Say why a session cannot determine its camera; None if it can."""
    return _lacking(model, _MANY_FRAMES, "determine")


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
    """What a session's frames show about the camera, and what errors of the camera do to the calibration.

    ``camera`` is None where the session does not test it, and ``undetermined`` then says why. ``covariance`` (K, K) is
    the mean square of the calibration's errors, in the order of `SessionModel.axes`, that errors of the camera cause.
    ``of_margin`` is what a margin of the masks does with the camera of the file; None where the camera cannot be
    changed. ``blocks`` are what is found of the sizes, and of those that state themselves (`SeenBlock.stated`).
    ``square`` (3, 3) is the mean square of what is wrong with the camera that was used; None where it is not tested.
    """

    camera: SessionCamera | None
    undetermined: str
    covariance: Float64
    of_margin: MarginEffect | None = None
    blocks: Mapping[str, FoundBlock] = field(default_factory=dict)
    square: Float64 | None = None


def errors_of_camera(check: CameraCheck, camera: Camera, config: CameraConfig) -> Float64:
    """Return the covariance (6, 6) of what a session was solved with, in the order of `PARAMETERS`.

    What the session finds and does not correct is an error of that camera as well. ``camera`` is that of the file, for
    images of any size; ``config`` counts where the session tests nothing.
    """
    errors, change = file_covariance(camera, config), check.camera
    lens = check.blocks.get(LENS)
    if lens is not None:
        errors[np.ix_(_OF_LENS, _OF_LENS)] = np.diag(np.square(lens.std) + np.square(lens.values))
    if change is not None and check.square is not None:
        to_relative = np.array([1.0, *(2 * [camera.width / change.width / camera.fx])])
        errors[np.ix_(TESTED, TESTED)] = check.square * np.outer(to_relative, to_relative)
    if SIZES in check.blocks:
        errors[-1, -1] = square_of_whole(check.blocks[SIZES], config.instrument_size_percent / 100)
    return errors


def _stated(
    there: Linearised, blocks: Sequence[SeenBlock], known: Mapping[str, Float64], shared: float
) -> tuple[dict[str, FoundBlock], Float64]:
    """State what is found of the blocks that state themselves.

    ``known`` are standard deviations of the priors of other blocks, as of the camera, ``shared`` the factor of shared
    errors on what the frames show, not on the blocks' own priors. Also returns the mean square (K, K) of the
    calibration's errors that their errors cause, which are not corrected.
    """
    calibration, count = there.solution.calibration, there.solution.calibration.own
    values, covariance = there.with_std(known)
    found, of_blocks = dict[str, FoundBlock](), np.zeros((count, count))
    for block in blocks:
        place = calibration.place(block.name)
        prior = np.diag(block.std**-2)
        shown, axes = np.linalg.eigh(np.linalg.inv(covariance[place, place]) - prior)
        spread = np.linalg.inv(prior + (axes * np.maximum(shown, 0.0) / shared**2) @ axes.T)
        if (stated := block.stated(values[place], np.sqrt(np.diag(spread)))) is not None:
            found[block.name] = stated
            moves = -inverse_information(there.information[:count, :count]) @ there.information[:count, place]
            of_blocks += moves @ (spread + np.outer(values[place], values[place])) @ moves.T
    return found, of_blocks


def check_camera(
    arms: Sequence[ArmOutlines], config: EstimateConfig, *, applied: Float64 | None = None
) -> list[CameraCheck]:
    """Test the camera of a calibrated session; returns what each arm has of it.

    ``applied`` is the change (3,) of the camera with which the frames were fitted, with which the block starts; None if
    they were fitted with the file's. Where an estimate is not
    plausible, only what the frames show at the camera of the file is left, which may contradict it or say nothing.
    """
    reasons = [_lacking(arm.model, _LEAST_FRAMES, "test") for arm in arms]
    reason = None if None in reasons else reasons[0]
    if not config.session.test_camera and applied is None:
        reason = _NOT_ASKED
    passes = _PASSES if reason is None and applied is None else 1
    try:
        begun = [arm.with_new_blocks().linearised() for arm in arms]
        found = linearise(arms, config.session, (CAMERA, SIZES), passes=passes, first=begun)
        if far := passes > 1 and not all(one.plausible for one in found):
            found = linearise(arms, config.session, (CAMERA, SIZES), passes=1, first=begun)
        first = found
        if reason != _NOT_ASKED and applied is None:
            file = CameraChange(file_deviations(arms[0].camera, config.camera))
            blocks = [tuple(file if one.name == CAMERA else one for one in arm.blocks) for arm in arms]
            by_file = [replace(arm, blocks=own) for arm, own in zip(arms, blocks, strict=True)]
            first = linearise(by_file, config.session, (SIZES,), passes=_FILE_PASSES, first=begun)
    except InputError as error:
        return [CameraCheck(None, f"camera: {error}", np.zeros((arm.calibration.alone().own,) * 2)) for arm in arms]
    each = zip(found, first, arms, strict=True)
    return [_checked(last, near, arm, config, reason, applied, far=far) for last, near, arm in each]


def _checked(
    there: Linearised,
    first: Linearised,
    outlines: ArmOutlines,
    config: EstimateConfig,
    reason: str | None,
    applied: Float64 | None,
    *,
    far: bool,
) -> CameraCheck:
    """Judge an estimate; ``reason`` is why the camera is not tested, ``far`` whether an estimate was not plausible.

    ``first`` is the estimate where the camera's file is a measurement of it.
    """
    calibration, file = there.solution.calibration, file_deviations(outlines.camera, config.camera)
    own, count = calibration.place(CAMERA), calibration.own
    change, covariance, known = there.value(CAMERA), there.covariance[own, own], {CAMERA: file}
    of_margin, sizes = None, dict[str, FoundBlock]()
    if any(block.name == SIZES for block in outlines.blocks):
        known[SIZES] = usual_sizes(config.camera)
        values, spread = there.with_std({**known, CAMERA: _WEAK_STD})
        change, covariance, sizes = values[own], spread[own, own], {SIZES: found_sizes(first, known)}
        of_margin = MarginEffect.of(first)
    blocks, of_blocks = _stated(there, outlines.blocks, known, config.session.shared_errors)
    blocks = sizes | blocks
    covariance = config.session.shared_errors**2 * covariance
    change = change if applied is None else applied
    camera = SessionCamera.of(change, covariance, file, outlines.camera.width, applied=applied is not None)
    if far and not camera.contradicts:
        reason = IMPLAUSIBLE
    square = np.diag(file**2)
    if applied is not None:
        square = covariance
    elif reason is None:
        square = _mean_square(change, covariance, file)
    moves = -inverse_information(there.information[:count, :count]) @ there.information[:count, own]
    of_camera = moves @ square @ moves.T + of_blocks
    if reason is not None:
        return CameraCheck(None, reason, of_camera, of_margin, blocks)
    return CameraCheck(camera, "", of_camera, of_margin, blocks, square)


def _mean_square(change: Float64, covariance: Float64, file: Float64) -> Float64:
    """Return the mean square (3, 3) of the errors of a camera file that is used as it is, by what frames and file show.

    A file is a measurement with the standard deviations ``file``, or with some probability one of another focal length,
    another principal point or both, of which frames say more the better they show the camera.
    """
    known = (1 + np.diag(covariance) / (_WRONG_STD * file) ** 2) ** -2
    shares = _WRONG_SHARE * np.array([known[0], known[1:].mean()])
    logs, squares = [], []
    for wrong in itertools.product((False, True), repeat=2):
        std = file * np.where([wrong[0], wrong[1], wrong[1]], _WRONG_STD, 1.0)
        mean, spread = _with_file(change, covariance, std)
        whole = np.linalg.slogdet(covariance + np.diag(std**2))[1] + _distance(change, covariance, std)
        logs.append(np.log(np.where(wrong, shares, 1 - shares)).sum() - 0.5 * whole)
        squares.append(spread + np.outer(mean, mean))
    weights = np.exp(np.array(logs) - max(logs))
    return np.asarray(np.einsum("k,kij->ij", weights / weights.sum(), squares))


def _distance(change: Float64, covariance: Float64, file: Float64) -> float:
    """Return the squared Mahalanobis distance of a change (3,) from the camera file, whose errors count as well."""
    return float(change @ np.linalg.solve(covariance + np.diag(file**2), change))


def _with_file(change: Float64, covariance: Float64, file: Float64) -> tuple[Float64, Float64]:
    """Return a change (3,) and its covariance (3, 3) with the camera file as a measurement that says: no change."""
    file_covariance = np.diag(file**2)
    gain = file_covariance @ np.linalg.inv(covariance + file_covariance)
    return gain @ change, gain @ covariance


def file_deviations(camera: Camera, config: CameraConfig) -> Float64:
    """Return the standard deviations (3,) of a camera's file: of its focal length, relative, and its centre, px."""
    std = np.sqrt(np.diag(file_covariance(camera, config)))
    return std[TESTED] * [1.0, camera.fx, camera.fx]
