"""What a session's frames determine of its camera: the change they fit, and whether they contradict the camera file.

The change has three unknowns: the logarithm of the focal length's factor and the shift of the principal point over the
focal length. It is estimated with the margin of the masks, which makes the shaft wider as a longer focal length does. A
single frame hardly determines it, because a change of its pose has nearly the same effect. In a session, the arm's
kinematics fix the distances between the remote centre of motion and the wrists, and thereby the scale along the optical
axis.
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
    distance,
    linearise,
    with_mixture,
    with_prior,
)
from dvrk_cmaes.calibration.masks_and_sizes import SIZES, MarginEffect, found_sizes, square_of_whole, usual_sizes
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_frame import changed
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import CameraConfig, EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.expected_error import PARAMETERS, displacements, file_covariance

CAMERA, LENS = "camera", "lens"
"""Names of the blocks."""

TESTED: Final = ("focal_length", "centre_right", "centre_down")
"""Which of the parameters of a camera are the three unknowns."""
_OF_LENS: Final = ("aspect", "radial")
_LENS_CAUSES: Final = "images that were stretched, --rectified with raw images or left out, or the file of another lens"
_WEAK_STD = np.array([0.3, 0.29, 0.29])  # of the change where it is estimated from the frames
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


class CameraErrors(SeenBlock):
    """Errors of some of a camera's ``parameters``, in the units of `PARAMETERS`; other arguments as of `SeenBlock`."""

    def __init__(self, name: str, parameters: Sequence[str], std: Float64, start: Float64 | None = None) -> None:
        super().__init__(name, std, start)
        self.parameters = parameters

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the errors."""
        camera, pixels = outline.view.camera, outline.points.pixels
        moved = displacements(camera, pixels, camera.normalise(pixels))[:, :, _places(self.parameters)]
        return np.asarray(np.einsum("nk,nkp->np", outline.points.normals, moved))


class CameraChange(CameraErrors):
    """The change (3,) of all cameras, by default with a wide prior; arguments as of `SeenBlock`."""

    shared = True

    def __init__(self, std: Float64 | None = None, start: Float64 | None = None) -> None:
        super().__init__(CAMERA, TESTED, _WEAK_STD if std is None else std, start)

    def is_plausible(self, values: Float64) -> bool:
        """Whether the outlines are not likely to have left the image."""
        return bool((np.abs(values) < PLAUSIBLE * _WEAK_STD).all())

    def seen(self, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view with the changed camera."""
        return replace(by, camera=changed(by.camera, values))


class Lens(CameraErrors):
    """The errors (2,) of a camera file: of log (fy / fx), and of the first radial coefficient."""

    is_linear = True

    def __init__(self, config: EstimateConfig, camera: Camera) -> None:
        super().__init__(LENS, _OF_LENS, file_deviations(camera, config.camera, _OF_LENS))
        self._shared = config.session.shared_errors

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
        text = f"{stated} (std {std[1]:.3f})"
        return FoundBlock.of(self.parameters, (values, std, self.std), text, doubt if clear else "")


def stated_camera(change: Float64, covariance: Float64, file: Float64, camera: Camera, *, applied: bool) -> FoundBlock:
    """State the change (3,) of a camera that some frames fit, with its covariance, and whether it contradicts the file.

    Where it does not and was not ``applied``, the file counts as a measurement with the standard deviations ``file``
    (3,), as of `file_deviations`.
    """
    contradicts = distance(change, covariance, file) > _CONTRADICTION
    if not (contradicts or applied):
        change, covariance = with_prior(change, covariance, file)
    std = np.sqrt(np.diag(covariance))
    scale, (right, down) = np.expm1(change[0]), camera.fx * change[1:]
    own, (of_right, of_down) = np.exp(change[0]) * std[0], camera.fx * std[1:]
    clear, parts = np.abs(change) > NAMED * np.hypot(std, file), []
    if clear[0] or not clear[1:].any():
        than = "longer" if scale > 0 else "shorter"
        parts.append(f"a focal length {100 * abs(scale):.1f} % (std {100 * own:.1f}) {than}")
    if clear[1:].any() or not clear[0]:
        across, along = "right" if right > 0 else "left", "down" if down > 0 else "up"
        parts.append(
            f"a principal point {abs(right):.0f} px (std {of_right:.0f}) {across} and {abs(down):.0f} px "
            f"(std {of_down:.0f}) {along}"
        )
    then = "which is used" if applied else f"likely causes: {_CAUSES}"
    doubt = f"the camera file is contradicted: these frames fit {' and '.join(parts)}; {then}" if contradicts else ""
    return FoundBlock.of(TESTED, (change, std, file), _in_words(change, std, camera), doubt, applied=applied)


def _in_words(change: Float64, std: Float64, camera: Camera) -> str:
    """Describe a change (3,) of a camera in words, with its standard deviations."""
    (right, down), (of_right, of_down) = camera.fx * change[1:], camera.fx * std[1:]
    return (
        f"camera, against the one used: focal length {100 * np.expm1(change[0]):+z.1f} % "
        f"(std {100 * np.exp(change[0]) * std[0]:.1f}), principal point {right:+z.0f} px right (std {of_right:.0f}), "
        f"{down:+z.0f} px down (std {of_down:.0f})"
    )


def of_the_camera_found(block: FoundBlock, camera: Camera) -> FoundBlock:
    """Return what is known of the camera that was found, where that takes the place of a camera's file."""
    none, std = np.zeros(len(TESTED)), np.array(block.std)
    return FoundBlock.of(TESTED, (none, std, np.array(block.prior_std)), _in_words(none, std, camera), applied=True)


def describe_found(block: FoundBlock, guess: Camera) -> str:
    """Describe the camera that was found without a file, by that which was guessed; say what would determine it."""
    found, (_, across, down) = changed(guess, np.array(block.values)), guess.fx * np.array(block.std)
    std = found.fx * block.std[0]
    return (
        f"no camera file: these frames determine a focal length of {found.fx:.0f} px (std {std:.0f}) "
        f"and a principal point at {found.cx:.0f}, {found.cy:.0f} px (std {across:.0f}, {down:.0f}), without lens "
        "distortion. A checkerboard in some 20 pictures determines all of these better (camera_calibration of "
        "ROS), a longer recording in which insertion moves by some centimetres the focal length"
    )


def camera_undetermined(model: SessionModel, least: int = _MANY_FRAMES, purpose: str = "determine") -> str | None:
    """Say why a session cannot determine its camera, or test it with fewer frames; None if it can."""
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

    ``blocks`` are what is found of the camera, where it is tested, else ``undetermined`` says why it is not, of the
    sizes, and of those that state themselves (`SeenBlock.stated`). ``covariance`` (K, K) is the mean square of the
    calibration's errors that errors of the camera cause. ``errors`` (6, 6) is that of what the session was solved with,
    in the order of `PARAMETERS`: what it finds and does not correct is an error as well. ``of_margin`` is what a margin
    of the masks does with the camera of the file; None where the camera cannot be changed.
    """

    undetermined: str
    covariance: Float64
    errors: Float64
    of_margin: MarginEffect | None = None
    blocks: Mapping[str, FoundBlock] = field(default_factory=dict)


def check_camera(
    arms: Sequence[ArmOutlines], config: EstimateConfig, *, applied: Float64 | None = None
) -> list[CameraCheck]:
    """Test the camera and the instrument's sizes in a calibrated session; returns what each arm has of it.

    ``applied`` is the change (3,) of the camera with which the frames were fitted, with which the block starts; None if
    they were fitted with the file's. Where an estimate is not plausible, only what the frames show at the camera of
    the file is left, which may contradict it or say nothing.
    """
    reasons = [camera_undetermined(arm.model, _LEAST_FRAMES, "test") for arm in arms]
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
        none = (np.zeros((arm.calibration.alone().own,) * 2) for arm in arms)
        return [CameraCheck(f"camera: {error}", each, file_covariance(arms[0].camera, config.camera)) for each in none]
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
    calibration, camera, shared = there.solution.calibration, outlines.camera, config.session.shared_errors
    file, errors = file_deviations(camera, config.camera), file_covariance(camera, config.camera)
    known = {CAMERA: file, SIZES: usual_sizes(config.camera)}
    values, spread = there.with_std({**known, CAMERA: _WEAK_STD})
    own = calibration.place(CAMERA)
    change, covariance = values[own] if applied is None else applied, shared**2 * spread[own, own]
    blocks = {CAMERA: stated_camera(change, covariance, file, camera, applied=applied is not None)}
    if far and not blocks[CAMERA].doubt:
        reason = IMPLAUSIBLE
    square = np.diag(file**2)
    if reason is None:
        square = covariance if applied is not None else _mean_square(change, covariance, file)
        errors[np.ix_(_places(TESTED), _places(TESTED))] = square
    else:
        del blocks[CAMERA]
    blocks[SIZES] = found_sizes(first, known)
    errors[-1, -1] = square_of_whole(blocks[SIZES], config.camera.instrument_size_percent / 100)
    moves = there.moved_by(CAMERA)
    of_camera = moves @ square @ moves.T
    values, spread = there.with_std(known)
    for block in outlines.blocks:
        place, prior = calibration.place(block.name), np.diag(block.std**-2)
        shown, axes = np.linalg.eigh(np.linalg.inv(spread[place, place]) - prior)
        # errors that frames share are of what they show, not of the block's own prior
        left = np.linalg.inv(prior + (axes * np.maximum(shown, 0.0) / shared**2) @ axes.T)
        if (stated := block.stated(values[place], np.sqrt(np.diag(left)))) is not None:
            blocks[block.name], moves = stated, there.moved_by(block.name)
            of_camera += moves @ (left + np.outer(values[place], values[place])) @ moves.T
    if LENS in blocks:
        lens = np.square(blocks[LENS].std) + np.square(blocks[LENS].values)
        errors[np.ix_(_places(_OF_LENS), _places(_OF_LENS))] = np.diag(lens)
    return CameraCheck(reason or "", of_camera, errors, MarginEffect.of(first), blocks)


def _mean_square(change: Float64, covariance: Float64, file: Float64) -> Float64:
    """Return the mean square (3, 3) of the errors of a camera file that is used as it is, by what frames and file show.

    A file is a measurement with the standard deviations ``file``, or with some probability one of another focal length,
    another principal point or both, of which frames say more the better they show the camera.
    """
    known = (1 + np.diag(covariance) / (_WRONG_STD * file) ** 2) ** -2
    shares, priors = _WRONG_SHARE * np.array([known[0], known[1:].mean()]), []
    for wrong in itertools.product((False, True), repeat=2):
        std = file * np.where([wrong[0], wrong[1], wrong[1]], _WRONG_STD, 1.0)
        priors.append((float(np.where(wrong, shares, 1 - shares).prod()), std))
    return with_mixture(change, covariance, priors)[1]


def file_deviations(camera: Camera, config: CameraConfig, parameters: Sequence[str] = TESTED) -> Float64:
    """Return the standard deviations of some parameters of a camera's file, in the units of `PARAMETERS`."""
    return np.sqrt(np.diag(file_covariance(camera, config)))[_places(parameters)]


def _places(parameters: Sequence[str]) -> list[int]:
    """Return which of all parameters some are."""
    return [PARAMETERS.index(name) for name in parameters]
