"""What a calibration tells the rules of `pose.doubts`, and the results that rest on a session."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from dvrk_cmaes.calibration.session_camera import IMPLAUSIBLE
from dvrk_cmaes.calibration.session_lag import UNREAD
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.pose.doubts import DISAGREES, LARGEST_LOSS, LARGEST_PREDICTED_PX, PREDICTS_BADLY, doubts
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration

R = TypeVar("R", bound=Result | TrackResult)

_FAR_INSERTION = 3.0  # standard deviations of prior and estimate together
_CAUSES_OF_ROLL = (
    "another instrument, a tool that was exchanged or homed during the recording, readings of another tool, or a lag "
    "between images and readings that is not taken out"
)
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
    """
    settings = SessionConfig() if config is None else config
    camera, shaft, masks = calibration.camera, calibration.shaft, calibration.masks
    agreeing, of_file = len(calibration.frames), camera is None or not camera.applied
    disagreeing, unread = (
        sum(reason.startswith(start) for reason in calibration.left_out.values()) for start in (DISAGREES, UNREAD)
    )
    contradictions = camera.contradictions(settings) if camera is not None and of_file else []
    found = doubts(
        "session",
        "session",
        iou=calibration.iou,
        predicted_iou=calibration.predicted_iou,
        predicted_px=calibration.predicted_px,
        largest_loss=LARGEST_LOSS,
        pixel_scale=pixel_scale,
        largest_px=LARGEST_PREDICTED_PX * pixel_scale,
        agreeing=agreeing,
        solved=agreeing + disagreeing,
        unread=unread,
        frames=agreeing + disagreeing + unread,
        sizes=[] if shaft is None else shaft.contradictions(),
        masks=masks,
        margin=0.0 if masks is None else abs(masks.margin_px),
        side="wide" if masks is not None and masks.margin_px > 0 else "narrow",
        remarks=calibration.remarks if of_file else (),
        contradictions=[text.partition(": ")[2] for text in contradictions],
        implausible=agreeing if IMPLAUSIBLE in calibration.untold else 0,
        insertion=abs(calibration.offsets["insertion"]),
        unusual=unusual_insertion(calibration, settings).partition(": ")[2],
        offsets=_offsets_of_cables(calibration),
        without_lag="" if calibration.lag else without_lag,
    )
    return tuple(found)


def _offsets_of_cables(calibration: SessionCalibration) -> list[tuple[str, float, float, str]]:
    """List the offsets beside insertion: name, offset and standard deviation, degrees, and causes if it is large.

    That of a joint whose readings are commanded values is no offset of its cables.
    """
    std = np.degrees(np.sqrt(np.diag(calibration.covariance)[7:])).tolist()
    named = zip(list(calibration.offsets.items())[1:], std, strict=True)
    return [
        (name, float(np.degrees(offset)), own, _CAUSES_OF_ROLL if name == "roll" else _CAUSES_OF_CABLES)
        for (name, offset), own in named
        if name not in calibration.commanded
    ]


def resting_on(result: R, calibration: SessionCalibration | None) -> R:
    """Return a result with the remarks of the session that it rests on; doubtful for the reasons for which that is.

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
    reasons = tuple(dict.fromkeys((*doubts("calibration", "solved", calibration), *result.reasons)))
    result = replace(result, reasons=reasons, remarks=remarks)
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
