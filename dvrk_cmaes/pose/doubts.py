"""The reasons for which a result is not ok: a function for each, None if it does not hold.

`reasons` lists those that hold. `pose.judge` asks those of a frame, `track` and `live` those of an image that is
followed; those of a session as a whole are in `calibration.session_doubts`. A rough mask alone is no reason: it makes
the expected error larger, which counts once it is beyond the limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.joints.interpolation import MOST_OFF, Sparseness
from dvrk_cmaes.pose.expected_error import tip_probability
from dvrk_cmaes.results.result import ExpectedError, Quality

Kind = Literal["alone", "solved", "followed"]
"""The results: of a frame by itself, of one with its session, and of an image that is followed."""

DISAGREES: Final = "disagrees with the session"
"""What the reason begins with for which a frame is left out that does not agree with the others."""
TIPS_NOT_ACCURATE: Final = "tips not accurate"
"""What the reason begins with for which the expected error of the tips is too large."""
OTHER_SIZES: Final = "another instrument (--instrument), or another focal length than the camera file's"
"""Why parts of an instrument may seem to have other sizes."""
BASE_APART: Final = "base far from the others'"
"""What the reason begins with for which a frame of a folder differs from the others."""
NO_READINGS: Final = "no readings: nothing distinguishes the pose from its mirror twin"
"""The reason of an instrument whose mirror twin has the same silhouette, and none of whose joints is read."""

_FAR_JOINTS = 2.1
"""Largest mean square of the joints' deviations in standard deviations, in images whose masks are found in them.

Of three joints, 90 % of normal errors are within it. In 19 recordings that were followed by masks, it is so of 98.5 %
of the ok frames; of the 11 images of another one in which a flap of tissue hides the tips, nine are beyond it, all
that are more than 3 mm off.
"""
_CERTAIN_MODE = 0.97  # probability of a mode that is not what makes the tips doubtful
_MIRRORED_OVERLAP = 0.6  # IoU of a view that is taken for the one on the other side
LEAST_OVERLAP: Final = 0.5
"""Intersection over union below which a mask does not support a pose, and a fit is not used."""
UNSUPPORTED: Final = 0.3
"""Share of the silhouette without the instrument's colours, from which on a pose is doubtful."""
MOST_DISAGREEING: Final = 10
"""Images in a row that disagree with the calibration, after which it does not hold any more."""
RELIED_ON: Final = 8
"""Keyframes of a solution, from which on its stated errors held; chosen on twelve recordings."""
_SLIP = 4.0  # standard deviations beyond which a joint's reading is reported


@dataclass(frozen=True)
class FrameLimits:
    """How far a frame may be from its mask and from what its session expects.

    what : what the frame belongs to, and what of it shows its pose, in words. factor : on the limits of contour, bend
    and missing overlap. outside : the jaw tips outside the image that make it doubtful, one of them or all, in words.
    overlap_loss : below the session's median intersection over union. largest_px, contour_factor : 95 % of the contour
    are within the larger one of the first, px in an image 640 px wide, and of the second times the session's median.
    """

    what: str
    factor: float
    outside: Literal["a jaw tip lies", "the jaw tips lie"]
    overlap_loss: float
    largest_px: float
    contour_factor: float


_ONE: Final = FrameLimits("session: the mask", 1.0, "a jaw tip lies", 0.03, 3.5, 1.5)
FOLLOWED: Final = FrameLimits("recording: the mask", 1.5, "the jaw tips lie", 0.15, 9.0, 3.0)
"""The limits of a frame by itself, and of one whose pose its neighbours support, too.

In 17 followed recordings with known truth, frames that only the limits of contour and bend made doubtful were as
accurate as others; so were those of four hard ones that only the overlap did.
"""
LIMITS: Final[dict[Kind, FrameLimits]] = {"alone": _ONE, "solved": _ONE, "followed": FOLLOWED}


def reasons(*found: str | None) -> list[str]:
    """Return those of some reasons that hold."""
    return [text for text in found if text is not None]


# a view of a pose, and its mask


def overlap_too_low(quality: Quality, least: float) -> str | None:
    """Judge the intersection over union of silhouette and mask."""
    if quality.iou < least:
        return f"overlap too low: IoU {quality.iou:.3f}, expected at least {least:.2f}"
    return None


def wrist_or_jaws_off(quality: Quality, most_px: float) -> str | None:
    """Judge how far the mask's contour beyond the shaft is from the silhouette."""
    if quality.distal_px > most_px:
        return (
            f"wrist or jaws off: beyond the shaft, the mask's contour is {quality.distal_px:.1f} px (rms) from the "
            "silhouette; another instrument, another tool or tissue may be there"
        )
    return None


def mask_cut_straight(quality: Quality, most_px: float) -> str | None:
    """Judge by how much the silhouette goes on beyond a straight line that ends the mask."""
    if quality.bend_px > most_px:
        return (
            f"mask cut straight: along a straight line that ends it, the silhouette bends by {quality.bend_px:.1f} px"
        )
    return None


def tip_out_of_view(limits: FrameLimits, outside: Sequence[bool]) -> str | None:
    """Judge which jaw tips lie outside the image."""
    if any(outside) if limits.outside == "a jaw tip lies" else all(outside):
        return f"tip out of view: {limits.outside} outside the image"
    return None


def tips_not_accurate(error: ExpectedError, trust: TrustConfig) -> str | None:
    """Judge the probability that the tips are within the limit, by the expected error of the right mode."""
    if not error.determined:
        return f"{TIPS_NOT_ACCURATE}: the mask does not determine them"
    probability = tip_probability(error.of_tips_mm, trust.tip_mm)
    if probability < trust.least_probability:
        return (
            f"{TIPS_NOT_ACCURATE}: their expected error is {error.of_tips_mm:.1f} mm, the probability that they are "
            f"within {trust.tip_mm:g} mm is {probability:.2f}"
        )
    return None


# several views


def view_mirrored(view: str, main: str, overlap: float) -> str | None:
    """Judge the overlap of a view with the pose as seen from the other side of the first view, ``main``."""
    if overlap > _MIRRORED_OVERLAP:
        return (
            f"views disagree: {view} fits {main} only from its other side: the images, masks or camera files of the "
            "two are exchanged"
        )
    return None


def _disagree(angle_deg: float, sigmas: float, trust: TrustConfig) -> bool:
    """Return whether the rotation with which a view fits the first one best contradicts the rig."""
    return angle_deg >= trust.largest_view_deg and sigmas >= trust.largest_view_sigmas


def view_turned(view: str, main: str, angle_deg: float, sigmas: float, trust: TrustConfig) -> str | None:
    """Judge the rotation, degrees and standard deviations, with which a view fits the first one, ``main``, best."""
    if _disagree(angle_deg, sigmas, trust):
        return (
            f"views disagree: {view} fits {main} only if turned by {angle_deg:.2f} deg; the rig may be calibrated "
            "wrongly, or the images are not of one time or exchanged"
        )
    return None


def rig_turned(view: str, frames: int, angle_deg: float, sigmas: float, trust: TrustConfig) -> str | None:
    """Judge the same rotation as all frames of a folder have it together."""
    if _disagree(angle_deg, sigmas, trust):
        return (
            f"views disagree in {frames} frames together: {view} fits the first view only if turned by "
            f"{angle_deg:.2f} deg ({sigmas:.0f} standard deviations); the rig seems to be calibrated wrongly"
        )
    return None


# a frame by itself


def mode_in_doubt(error: ExpectedError, of_mode: float, rival: str, trust: TrustConfig) -> str | None:
    """Judge the probability that the tips are within the limit, with that of the mode, ``of_mode``.

    ``rival`` says which other mode there is.
    """
    probability = tip_probability(error.of_tips_mm, trust.tip_mm, of_mode=of_mode)
    if probability >= trust.least_probability:
        return None
    if of_mode < _CERTAIN_MODE:
        return f"mode in doubt: the pose is in the right mode with a probability of {of_mode:.2f}; {rival}"
    if tip_probability(error.of_tips_mm, trust.tip_mm) >= trust.least_probability:
        return f"tips in doubt: they are within {trust.tip_mm:g} mm with a probability of {probability:.2f}"
    return None


def readings_against_outline(gap: float, trust: TrustConfig) -> str | None:
    """Judge by how much the outline's sum of squares is less in another mode."""
    if gap > trust.largest_outline_gap:
        return "readings against outline: a pose farther from the readings explains the mask clearly better"
    return None


def far_from_readings(names: Sequence[str], sigmas: Sequence[float], trust: TrustConfig) -> list[str]:
    """Judge the distances of the joints from their readings, standard deviations; NaN where a joint is not read."""
    far = [(name, off) for name, off in zip(names, sigmas, strict=True) if off > trust.largest_reading_sigmas]
    if not far and sum(off**2 for off in sigmas if off == off) > trust.largest_reading_sum:
        return ["far from the readings: all joints together are farther off than readings are"]
    return [f"far from the readings: {name} is {off:.1f} times the expected error away" for name, off in far]


def shaft_not_found(found: bool) -> str | None:
    """Judge whether the edges of the shaft were found in the mask of any view."""
    return None if found else "shaft not found: no two edges in the mask could bound it"


def points_off(error_px: float, most_px: float) -> str | None:
    """Judge the distance, px rms, of detected points from where a pose by them alone puts them."""
    return f"points: {error_px:.1f} px rms from where the pose puts them" if error_px > most_px else None


def mask_is_a_guess(confidence: float, least: float) -> str | None:
    """Judge the confidence of a mask that was found in an image."""
    return f"mask is a guess: confidence {confidence:.2f}, expected at least {least}" if confidence < least else None


def base_apart(angle_deg: float, most_deg: float) -> str | None:
    """Judge the rotation of the base that a frame implies from that of the other frames of its folder."""
    if angle_deg > most_deg:
        return (
            f"{BASE_APART}: rotated by {angle_deg:.0f} deg, expected at most {most_deg:.0f} deg; another mode, or "
            "wrong readings"
        )
    return None


# what a session's calibration expects of a frame


def mask_not_explained(quality: Quality, least_iou: float, most_px: float) -> str | None:
    """Judge overlap and contour by the medians of the session's frames."""
    if quality.iou < least_iou or quality.contour_px_95 > most_px:
        return (
            f"mask not explained: IoU {quality.iou:.3f}, {quality.contour_px_95:.1f} px at 95 % of the contour, "
            f"expected at least {least_iou:.3f} and at most {most_px:.1f} px"
        )
    return None


def pose_not_expected(limits: FrameLimits, misfit: float, most: float) -> str | None:
    """Judge the squared distance of a pose from what calibration and readings expect, per parameter."""
    if not misfit <= most:
        return (
            f"disagrees with the {limits.what} is {misfit**0.5:.1f} times the expected error from what the "
            "calibration and the readings expect"
        )
    return None


def frame_disagrees(misfit: float, most: float, explained: tuple[float, float] | None) -> str | None:
    """Judge whether a frame agrees with the others of its session.

    ``misfit`` is its squared distance from what the session expects, per parameter. ``explained`` are the overlaps of
    its mask with what the session expects and with its own pose, if the former does not explain the mask.
    """
    if not misfit < most:
        return f"{DISAGREES}: {misfit**0.5:.1f} times the expected error from what it expects"
    if explained is not None:
        iou, own = explained
        return f"{DISAGREES}: what it expects does not explain the mask (IoU {iou:.2f}, by itself {own:.2f})"
    return None


def reading_slipped(joint: str, error_deg: float, sigmas: float) -> str | None:
    """Judge the error of a joint's reading in one frame of a session, degrees and standard deviations."""
    if sigmas > _SLIP:
        return f"reading of {joint}: {error_deg:.0f} deg off in this frame, beyond the session's offset"
    return None


# an image that is followed


def pose_lost(source: str, iou: float | None) -> str | None:
    """Judge the overlap of a pose with the mask; None if the mask or image, ``source``, gave no pose."""
    if iou is None:
        return f"lost: the {source} shows nothing of the instrument"
    return f"lost: the mask does not support the pose (IoU {iou:.2f})" if iou < LEAST_OVERLAP else None


def silhouette_without_colours(share: float) -> str | None:
    """Judge the share of the silhouette that has not the instrument's colours."""
    return (
        f"{100 * share:.0f} % of the silhouette are without the instrument's colours" if share > UNSUPPORTED else None
    )


def joints_far_from_recording(joint: str, off_deg: float, mean_square: float) -> str | None:
    """Judge the joints' mean square distance, standard deviations, from what is expected; ``joint`` is the farthest."""
    if mean_square > _FAR_JOINTS:
        return (
            f"joints far from the recording: {joint} is {off_deg:+.0f} deg from what readings and calibration expect; "
            "something may hide the end of the instrument"
        )
    return None


def readings_missing(has_outer: bool, still: bool, source: str) -> str | None:
    """Judge whether readings of the outer joints say where the instrument is; ``still`` if they do not change."""
    if not has_outer:
        return "no readings: none of the outer joints at the time of the image less the lag"
    return f"readings stand still: only the {source} shows where the instrument is" if still else None


def readings_too_sparse(sparse: Sparseness) -> str | None:
    """Judge how far readings between two rows may be off."""
    return f"readings too sparse: {sparse.between}" if sparse.off > MOST_OFF else None


def readings_frozen(since: str) -> str | None:
    """Say since which frame the readings are the same although the mask moves; an empty text if they are not."""
    return f"readings frozen since frame {since}: the mask moves, and they do not" if since else None


def calibration_contradicted(images: int) -> str | None:
    """Judge the number of images in a row that disagree with the calibration."""
    if images >= MOST_DISAGREEING:
        return (
            f"calibration contradicted: {images} images in a row disagree with it; the base or the camera may have "
            "moved"
        )
    return None


def too_few_keyframes(tip_mm: float, keyframes: int) -> str | None:
    """Judge the number of keyframes of a calibration by which the tips are known to ``tip_mm``."""
    if keyframes < RELIED_ON:
        return f"too few keyframes to rely on: {base_known(tip_mm, keyframes)}"
    return None


def base_uncertain(tip_mm: float, keyframes: int, std_mm: float | None, most_mm: float) -> str | None:
    """Say how well the base is known, if that leaves the tips uncertain; ``std_mm`` is theirs, None without a pose."""
    return base_known(tip_mm, keyframes) if std_mm is not None and std_mm > most_mm else None


def base_known(tip_mm: float, keyframes: int) -> str:
    """Say to how many mm at the tips the base is known, by how many keyframes."""
    return f"base known to {tip_mm:.2g} mm, {keyframes} keyframes"


def base_not_known(keyframes: int, known: str) -> str:
    """Say that the base is not known, by how many keyframes, and what else is known."""
    return f"base not known yet: {keyframes} keyframes{known}"


NO_OUTER_READINGS: Final = "no readings of the outer joints so far"
"""The reason of an image while no calibration can be used."""
NOT_FOUND: Final = "not found: the first image could not be solved"
"""The reason of an image by which no search is running, and none found the instrument."""


def search_running(time: float) -> str:
    """Say that the image of a time, s, is searched."""
    return f"searching: the image of {time:.3f} s"


def image_black(brightest: int, black_level: int) -> str | None:
    """Judge the brightest pixel of an image."""
    return "black image: nothing can be seen" if brightest < black_level else None


def mask_says_nothing(given: bool, shown: bool, surrounded: bool) -> str | None:
    """Judge whether there is a mask, and whether it has pixels of the instrument and others."""
    if not given:
        return "no mask: the pose is predicted"
    if not shown:
        return "empty mask: the instrument is not in view"
    return None if surrounded else "full mask: no edge can be seen"


def image_frozen(source: str, same: bool) -> str | None:
    """Judge whether the mask or image, ``source``, is that of the time before although the arm moved."""
    return f"frozen image: the {source} is that of the image before, but the arm moved" if same else None


def image_old(age: float, oldest: float) -> str | None:
    """Judge the age of an image when its pose is published, s."""
    return f"the image is {age:.1f} s old" if age > oldest else None
