"""What a session's frames determine of its cameras: how these differ from their files, and where they contradict these.

The change of the camera has three unknowns: the logarithm of the focal length's factor and the shift of the principal
point over the focal length. It is estimated with the margin of the masks, which makes the shaft wider as a longer focal
length does. A single frame hardly determines it, because a change of its pose has nearly the same effect. In a session,
the arm's kinematics fix the distances between the remote centre of motion and the wrists, and thereby the scale along
the optical axis.

Of a rig, each frame's own result states by which rotation each further view would fit the first one better. The errors
of the masks differ from frame to frame, while a wrong calibration turns the view in all of them alike. At one distance
a wrong baseline looks like a rotation about the axis across it. The rotation is none of the blocks that are solved: it
is taken out before frames are fitted by both views, and `batch` states it of frames that no session has solved.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import (
    CLEAR,
    NAMED,
    FoundBlock,
    OutlineOfView,
    SeenBlock,
    ViewAsSeen,
    distance,
    square_by_file,
    with_prior,
)
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_frame import changed
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import CameraConfig, EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.pose.expected_error import PARAMETERS, displacements, file_covariance
from dvrk_cmaes.results.result import Result

CAMERA, LENS = "camera", "lens"
"""Names of the blocks."""

TESTED: Final = ("focal_length", "centre_right", "centre_down")
"""Which of the parameters of a camera are the three unknowns."""
_LENS_CAUSES: Final = "images that were stretched, --rectified with raw images or left out, or the file of another lens"
_WEAK_STD = np.array([0.3, 0.29, 0.29])  # of the change where it is estimated from the frames
PLAUSIBLE = 2.0  # of these; linearised farther away, outlines leave the image
_MANY_FRAMES = 10
_LEAST_INSERTION = 5e-3  # m, range of the readings
_CONTRADICTION = 16.27  # squared distance from no change, of 99.9 % with three unknowns
IMPLAUSIBLE = (
    "camera: its estimate from these frames is not plausible; frames with other poses of the arm, above all another "
    "insertion, determine it better"
)
"""Why a session does not determine its camera: the estimate is too far away for outlines that were linearised here."""

_CENTRE_BY_RADIAL = 0.2  # of focal lengths per radial coefficient: where outlines show the principal point by its error
_LENS_PLAUSIBLE = (0.5, 3.0)  # of both errors of a lens; outlines that were linearised say nothing of larger ones
_CAUSES = (
    "a calibration of another zoom, focus, endoscope or crop of the image, or --rectified left out; a tool or arm of "
    "another length has a similar effect"
)


class CameraErrors(SeenBlock):
    """Errors of some of a camera's ``parameters``, in their units."""

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the errors."""
        camera, pixels = outline.view.camera, outline.points.pixels
        moved = displacements(camera, pixels, camera.normalise(pixels))[:, :, places_of(self.parameters)]
        return np.asarray(np.einsum("nk,nkp->np", outline.points.normals, moved))


class CameraChange(CameraErrors):
    """The change (3,) of all cameras, against the file of one.

    Parameters
    ----------
    config, camera
        Settings, and the camera as its file has it.
    change
        The change (3,) with which the session is solved so far; None where it is not to be changed.
    """

    shared = True
    parameters = TESTED

    def __init__(self, config: EstimateConfig, camera: Camera, change: Float64 | None) -> None:
        file = file_deviations(camera, config.camera, TESTED)
        super().__init__(CAMERA, _WEAK_STD, change)
        self.known, self.weak, self.used, self._camera = file, _WEAK_STD, change is not None, camera
        radial = file_deviations(camera, config.camera, ("radial",))
        self._by_lens = np.diag(np.concatenate([[0.0], *[_CENTRE_BY_RADIAL * radial] * 2]) ** 2)

    def is_plausible(self, values: Float64) -> bool:
        """Whether the outlines are not likely to have left the image, over which the lens remains one-to-one."""
        try:
            changed(self._camera, values)
        except InputError:
            return False
        return bool((np.abs(values) < PLAUSIBLE * _WEAK_STD).all())

    def seen(self, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view with the changed camera."""
        return replace(by, camera=changed(by.camera, values)) if values.any() else by

    def stated(self, alone: Float64, covariance: Float64) -> tuple[FoundBlock, Float64]:
        """State the change with which the session is solved, or what the frames show and the file."""
        change, covariance = self.start if self.used else alone, covariance + self._by_lens
        found = stated_camera(change, covariance, self.known, self._camera, applied=self.used)
        return found, covariance if self.used else square_by_file(change, covariance, self.known, (0, 1, 1))


class Lens(CameraErrors):
    """The errors (2,) of a camera file: of log (fy / fx), and of the first radial coefficient."""

    parameters = ("aspect", "radial")

    def __init__(self, config: EstimateConfig, camera: Camera) -> None:
        super().__init__(LENS, file_deviations(camera, config.camera, self.parameters))

    def stated(self, alone: Float64, covariance: Float64) -> tuple[FoundBlock, Float64]:
        """State both, and what the frames alone show of them where that contradicts the file."""
        spread = np.sqrt(np.diag(covariance))
        values, left = with_prior(alone, covariance, self.std)
        std = np.sqrt(np.diag(left))
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
        found = FoundBlock.of(self.parameters, (values, std, self.std), text, doubt if clear else "")
        return found, square_by_file(alone, covariance, self.std, (0, 1))


def stated_camera(change: Float64, covariance: Float64, file: Float64, camera: Camera, *, applied: bool) -> FoundBlock:
    """State the change (3,) of a camera that some frames fit, with its covariance, and whether it contradicts the file.

    Where it does not and was not ``applied``, the file counts as a measurement with the standard deviations ``file``
    (3,), as of `file_deviations`.
    """
    contradicts, alone = distance(change, covariance, file) > _CONTRADICTION, ""
    if not (contradicts or applied):
        least = np.sqrt(_CONTRADICTION * (np.diag(covariance) + file**2))
        right, down = camera.fx * least[1:]
        size = f"{100 * least[0]:.0f} %, {right:.0f} px and {down:.0f} px"
        alone = f"; smaller errors of the file than {size} are not seen in these frames"
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
    return FoundBlock.of(TESTED, (change, std, file), _in_words(change, std, camera) + alone, doubt, applied=applied)


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


def file_deviations(camera: Camera, config: CameraConfig, parameters: Sequence[str]) -> Float64:
    """Return the standard deviations of some parameters of a camera's file, in the units of `PARAMETERS`."""
    return np.sqrt(np.diag(file_covariance(camera, config)))[places_of(parameters)]


def places_of(parameters: Sequence[str]) -> list[int]:
    """Return which of all parameters some are."""
    return [PARAMETERS.index(name) for name in parameters]


FEWEST = 3
"""Least number of frames in which a view is compared."""

LEAST_STD = np.array([0.01, 0.03, 0.01])
"""Least standard deviations, deg: a session's masks share errors that the scatter of its frames does not show.

About y the eyes see an instrument at 5 mm / 150 mm = 2 deg apart, which errors of its distance change in proportion:
1 % of the focal length and half a pixel of the shaft's width are 1.5 % of the distance.
"""

_RIG: Final = "rig "  # begins the name of the block of a view
_LEAST_ANGLE = 0.04  # deg, beyond which a view is turned, if it clearly is
_PASSES = 20  # of the weights
_TAIL = 9.0  # squared distance, in units of the common one, at which a frame has half of its weight
_MEDIAN_SQUARE = 2.366  # median of the squared distance of three unknowns


def rotations_of_session(results: Iterable[Result]) -> dict[str, FoundBlock]:
    """State the rotation of each further view, rad, by the results of a session's frames, each found by itself.

    The block is applied where the rotation is clear of zero. Views that are compared in fewer than three frames are
    left out.
    """
    return {f"{_RIG}{found[0]}": _stated_view(*found) for found in rotations_of_views(results)}


def _stated_view(view: str, count: int, rotation_deg: Float64, own_deg2: Float64) -> FoundBlock:
    """State the rotation of a view that was compared in a number of frames."""
    covariance = own_deg2 + np.diag(LEAST_STD**2)
    turned, std = is_turned(rotation_deg, covariance), np.sqrt(np.diag(covariance))
    clear = np.abs(rotation_deg) > NAMED * std
    clear[np.argmax(np.abs(rotation_deg) / std)] = True
    parts = [
        f"{value:.2f} +- {max(spread, 0.005):.2f} deg about {axis}"
        for axis, value, spread, named in zip("xyz", rotation_deg, std, clear, strict=True)
        if named
    ]
    than, against = ("rotated by", " against the file") if turned else ("as in the file:", "")
    text = f"the {view} eye is {than} {', '.join(parts)}{against}, in {count} frames"
    each = np.deg2rad(rotation_deg), np.deg2rad(std), np.full(3, np.pi)
    return FoundBlock.of("xyz", each, text, applied=turned)


def rotations_of_views(results: Iterable[Result]) -> Iterator[tuple[str, int, Float64, Float64]]:
    """Yield name, number of frames, rotation (3,), degrees, and its covariance of each view in three frames or more."""
    rotations_of: dict[str, list[tuple[Float64, Float64]]] = {}
    for result in results:
        for check in result.view_fits[1:]:
            pair = np.asarray(check.rotation_deg), np.asarray(check.covariance_deg2)
            rotations_of.setdefault(check.name, []).append(pair)
    for name, rotations in rotations_of.items():
        if len(rotations) >= FEWEST:
            yield name, len(rotations), *pooled_rotation(rotations)


def is_turned(rotation_deg: Float64, covariance_deg2: Float64) -> bool:
    """Return whether a rotation (3,) with its covariance (3, 3) is clear of zero."""
    sigmas = float(np.sqrt(rotation_deg @ np.linalg.solve(covariance_deg2, rotation_deg)))
    return sigmas > CLEAR and float(np.linalg.norm(rotation_deg)) > _LEAST_ANGLE


def turns_of(blocks: Mapping[str, FoundBlock]) -> dict[str, Float64]:
    """Return the rotations (3,), rad, of the views that are not used as in the file, by name."""
    return {
        name.removeprefix(_RIG): np.array(found.values)
        for name, found in blocks.items()
        if name.startswith(_RIG) and found.applied
    }


def pooled_rotation(rotations: Sequence[tuple[Float64, Float64]]) -> tuple[Float64, Float64]:
    """Return the robust mean of rotations (3,) weighted by their covariances (3, 3), and its covariance.

    The covariance grows where the rotations scatter more than their own covariances say; single ones that are far off,
    as of a frame in a wrong mode, count less.
    """
    values = np.array([rotation for rotation, _ in rotations])
    weights = np.linalg.inv(np.array([covariance for _, covariance in rotations]))
    mean = np.median(values, axis=0)
    for _ in range(_PASSES):
        off = values - mean
        squares = np.einsum("ki,kij,kj->k", off, weights, off)
        common = max(1.0, float(np.median(squares)) / _MEDIAN_SQUARE)
        share = 1 / (1 + squares / (_TAIL * common))
        covariance = np.linalg.inv(np.einsum("k,kij->ij", share, weights))
        mean = covariance @ np.einsum("k,kij,kj->i", share, weights, values)
    scatter = float(share @ squares) / max(3 * (float(share.sum()) - 1), 1.0)
    return mean, covariance * max(1.0, scatter)
