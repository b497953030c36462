"""The reasons for which a session as a whole is doubtful, and the results that rest on one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from dvrk_cmaes.calibration.blocks import CLEAR
from dvrk_cmaes.calibration.lag import NO_READINGS_AT_LAG
from dvrk_cmaes.camera.fields import known_mistakes
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.pose.doubts import DISAGREES, reasons
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration

_NEAR_IN_DOUBT = 0.6
"""Share of tips within 1.8 mm of the truth in doubtful sessions: 47 of 80 of `scripts/measure.py --falsify inputs`."""

R = TypeVar("R", bound=Result | TrackResult)

PREDICTS_BADLY: Final = "this calibration predicts frames badly that it has not seen"
"""What the reason begins with for which a calibration is not used for other frames."""
LARGEST_LOSS: Final = 0.15
"""Of the overlap, from the frames' own fits to their predictions by the others."""
_LOSS_FAR_OFF = 0.1  # the same where contours are far off, as errors of the wrist's readings alone make them, too
_TRUSTED_SHARE = 0.5  # of the frames that were solved together; if no more agree, these few may be the wrong ones
LARGEST_PREDICTED_PX: Final = 2.5
"""Median distance of the contours of frames from what the other frames of their session predict, at 640 px of width."""
_LACKING_SHARE = 0.5  # of the frames, whose masks lack the end of a jaw; of 60 right frames of all kinds one does
_LARGEST_INSERTION = 10e-3  # m, beyond which tools of one kind do not differ
_BEYOND_CABLES_DEG = {"wrist": 20.0, "jaw": 30.0}  # by the beginning of the joint's name; roll is homed by hand
_FAR_INSERTION = 3.0  # standard deviations of prior and estimate together
_CAUSES_OF_CABLES = "another instrument, a tool that was not homed, a coupling of another tool, or slipped cables"
_CAUSES_OF_INSERTION = (
    "another focal length than the camera file's, an instrument with another shaft (--instrument), a tool or arm of "
    "another length (--tool, --arm), or a lag between images and readings that is not taken out"
)


def doubts_of(
    calibration: SessionCalibration,
    config: SessionConfig | None = None,
    *,
    without_lag: str = "",
    pixel_scale: float = 1.0,
    ends_lacking: Sequence[bool] = (),
) -> tuple[str, ...]:
    """List what is wrong with a session as a whole and was not put right; empty where nothing is.

    Parameters
    ----------
    calibration
        The calibration, whose stated values are judged.
    config
        Settings with which it was made; the defaults if they are not known.
    without_lag
        Why the frames agree at no lag between images and readings; empty if they agree at one, or none was searched.
    pixel_scale
        That of the frames' camera, on limits in pixels.
    ends_lacking
        Whether the mask of each frame that was used lacks the end of a jaw.
    """
    settings = SessionConfig() if config is None else config
    camera = calibration.blocks.get("camera")
    by_file, unusual = camera is None or not camera.applied, unusual_insertion(calibration, settings)
    return (
        *reasons(predicts_badly(calibration, LARGEST_PREDICTED_PX * pixel_scale)),
        *few_frames(calibration),
        *(block.doubt for block in calibration.blocks.values() if block.doubt and not block.applied),
        *known_mistakes(calibration.remarks if by_file else ()),
        *([unusual] if unusual and abs(calibration.offsets["insertion"]) > _LARGEST_INSERTION else []),
        *offsets_beyond_cables(calibration),
        *([f"lag between images and readings: {without_lag}"] if without_lag and not calibration.lag else []),
        *reasons(ends_missing(ends_lacking)),
    )


def predicts_badly(calibration: SessionCalibration, most_px: float) -> str | None:
    """Judge how frames agree with what the other frames predict."""
    predicted, own, px = calibration.predicted_iou, calibration.iou, calibration.predicted_px
    if own - predicted > (_LOSS_FAR_OFF if px > most_px else LARGEST_LOSS):
        return (
            f"{PREDICTS_BADLY}: IoU {predicted:.2f} by the other frames, {own:.2f} by their own fits, contour "
            f"{px:.1f} px off, expected at most {most_px:.1f} px; its lag, camera file, instrument or readings may be "
            "wrong"
        )
    return None


def few_frames(calibration: SessionCalibration) -> list[str]:
    """Judge the shares of the frames that agree on the base, and that have readings once the lag is taken out."""
    agreeing, left_out, found = len(calibration.frames), calibration.left_out.values(), list[str]()
    starts = DISAGREES, NO_READINGS_AT_LAG
    off, without = (sum(reason.startswith(start) for reason in left_out) for start in starts)
    solved, frames = agreeing + off, agreeing + off + without
    if agreeing <= _TRUSTED_SHARE * solved:
        found.append(
            f"only {agreeing} of {solved} frames agree on where the arm's base is: the others' masks or the readings "
            "are wrong, or these few are"
        )
    if solved <= _TRUSTED_SHARE * frames:
        found.append(
            f"the lag leaves {without} of {frames} frames without readings: it is wrong, or rows of readings are "
            "missing"
        )
    return found


def ends_missing(missing: Sequence[bool]) -> str | None:
    """Judge in how many of the frames the mask lacks the end of a jaw."""
    if sum(missing) > _LACKING_SHARE * len(missing):
        return f"the ends of the jaws are missing from the masks in {sum(missing)} of {len(missing)} frames"
    return None


def offsets_beyond_cables(calibration: SessionCalibration) -> list[str]:
    """Judge the offsets of wrist and jaw, which are doubtful where they are clearly beyond what cables do.

    That of a joint whose readings are commanded values is no offset of its cables.
    """
    std = np.degrees(np.sqrt(np.diag(calibration.covariance)[7:])).tolist()
    found = []
    for (name, offset), own in zip(list(calibration.offsets.items())[1:], std, strict=True):
        deg = float(np.degrees(offset))
        most = next((limit for start, limit in _BEYOND_CABLES_DEG.items() if name.startswith(start)), np.inf)
        if name not in calibration.commanded and abs(deg) - most > CLEAR * own:
            found.append(
                f"offset of {name}: {deg:+z.1f} deg (std {own:.1f}), where {most:.1f} deg are the most that cables "
                f"do; likely causes: {_CAUSES_OF_CABLES}"
            )
    return found


def resting_on(result: R, calibration: SessionCalibration | None) -> R:
    """Return a result with the remarks of the session that it rests on; doubtful for the reasons for which that is.

    The stated probability of its tips is then that in doubtful sessions.

    Parameters
    ----------
    result
        A result of a frame or of a followed image, by the calibration or with its camera.
    calibration
        The session's calibration; without one, the result stays as it is.
    """
    if calibration is None:
        return result
    remarks = tuple(dict.fromkeys((*result.remarks, *calibration.remarks)))
    doubts = tuple(dict.fromkeys((*(f"session: {text}" for text in calibration.doubts), *result.reasons)))
    result = replace(result, reasons=doubts, remarks=remarks)
    if calibration.doubts and result.tip_probability is not None:
        result = replace(result, tip_probability=_NEAR_IN_DOUBT * result.tip_probability)
    return replace(result, status="doubtful") if calibration.doubts and result.status == "ok" else result


def bad_predictions(calibration: SessionCalibration) -> str:
    """Say by how much a calibration predicts frames badly; empty if it does not.

    The silhouettes that the other frames predict overlap the masks far less than those of the frames' own fits, or are
    far from their contours, whatever the stated standard deviations.

    Parameters
    ----------
    calibration
        The calibration.
    """
    return next((doubt for doubt in calibration.doubts if doubt.startswith(PREDICTS_BADLY)), "")


def unusual_insertion(calibration: SessionCalibration, config: SessionConfig) -> str:
    """Describe an offset of insertion that is larger than usual, with likely causes; empty where it is not.

    Parameters
    ----------
    calibration
        The calibration, in which the offset is taken out.
    config
        Settings with which it was made.
    """
    off, usual = 1e3 * calibration.offsets["insertion"], config.insertion_offset_mm
    own = 1e3 * float(np.sqrt(calibration.covariance[6, 6]))
    if abs(off) <= _FAR_INSERTION * float(np.hypot(own, usual)):
        return ""
    return (
        f"offset of insertion: {off:+z.1f} mm (std {own:.1f}), where {usual:.1f} mm are usual; likely causes: "
        f"{_CAUSES_OF_INSERTION}"
    )
