"""What makes a session doubtful, and every result that rests on it: the rows of the table `OF_SESSIONS`.

The table of frames is `OF_FRAMES` of `pose.doubts`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from dvrk_cmaes.calibration.instrument_test import better_instrument
from dvrk_cmaes.calibration.session_camera import IMPLAUSIBLE
from dvrk_cmaes.camera.critical import known_mistakes
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.results.tracked import TrackResult

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration

R = TypeVar("R", bound=Result | TrackResult)

DISAGREES: Final = "disagrees with the session"
"""What the reason begins with for which a frame is left out that does not agree with the others."""

_LARGEST_LOSS = 0.15  # of the overlap, from the frames' own fits to their predictions by the others
_TRUSTED_SHARE = 0.5  # of the frames that were solved together; if fewer agree, these few may be the wrong ones
_LARGEST_MARGIN_PX = 2.0  # of all masks of a session
_TELL_THE_CAMERA = 40
"""Number of frames of a right session by which an estimate of the camera does not run away.

It did so in 2 of 159 sessions of more than 30 frames, both wrong, and in 4 of 100 of 10 to 30, some of them right.
"""
_FAR_INSERTION = 3.0  # standard deviations of prior and estimate together
_LARGEST_INSERTION = 10e-3  # m, beyond which tools of one kind do not differ
_BEYOND_CABLES_DEG = {"roll": 15.0, "wrist": 20.0, "jaw": 30.0}  # by the beginning of the joint's name
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
    calibration: SessionCalibration, config: SessionConfig | None = None, *, without_lag: str = ""
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
    """
    settings = SessionConfig() if config is None else config
    lag = f"lag between images and readings: {without_lag}" if without_lag and not calibration.lag else ""
    found = [text for rule in OF_SESSIONS.values() for text in rule(calibration, settings)]
    return tuple(text for text in (*found, lag) if text)


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
    reasons = tuple(dict.fromkeys((*(f"session: {text}" for text in calibration.doubts), *result.reasons)))
    result = replace(result, reasons=reasons, remarks=remarks)
    return replace(result, status="doubtful") if calibration.doubts and result.status == "ok" else result


def bad_predictions(calibration: SessionCalibration) -> str:
    """Say by how much a calibration predicts frames badly; empty if it does not.

    The silhouettes that the other frames predict overlap the masks far less than those of the frames' own fits,
    whatever the stated standard deviations.

    Parameters
    ----------
    calibration
        The calibration.
    """
    predicted = calibration.predicted_iou
    if predicted >= calibration.iou - _LARGEST_LOSS:
        return ""
    return (
        f"this calibration predicts frames badly that it has not seen: IoU {predicted:.2f} by the other frames, "
        f"{calibration.iou:.2f} by their own fits; its lag, camera file, instrument or readings may be wrong"
    )


def _wide_masks(calibration: SessionCalibration) -> str:
    """Say that the masks are wider or narrower than segmenters make them; empty if they are not."""
    masks = calibration.masks
    if masks is None or abs(masks.margin_px) <= _LARGEST_MARGIN_PX:
        return ""
    wide = "wide" if masks.margin_px > 0 else "narrow"
    return (
        f"masks are {abs(masks.margin_px):.1f} px (std {masks.std_margin_px:.1f}) too {wide} all round: more than "
        "segmenters err; another instrument, another focal length or masks that were widened have this effect"
    )


def _wrong_camera(calibration: SessionCalibration, config: SessionConfig) -> list[str]:
    """Describe what of the camera file the frames contradict, unless the session was solved with another camera."""
    camera = calibration.camera
    return [] if camera is None or camera.applied else camera.contradictions(config)


def _untested_camera(calibration: SessionCalibration) -> str:
    """Say that many frames fit no plausible camera; empty where they do, or are few."""
    if len(calibration.frames) < _TELL_THE_CAMERA or IMPLAUSIBLE not in calibration.untold:
        return ""
    return (
        "the camera file cannot be tested: many frames, which fit none that is plausible; their masks are wrong alike, "
        "the readings are, or the base moved"
    )


def _mistaken_camera(calibration: SessionCalibration) -> list[str]:
    """List known mistakes of the camera's file; none where the session was solved with another camera."""
    camera = calibration.camera
    return [] if camera is not None and camera.applied else known_mistakes(calibration.remarks)


def _few_agree(calibration: SessionCalibration) -> str:
    """Say that only few of the frames that were solved together agree; empty if enough do."""
    agree = len(calibration.frames)
    count = agree + sum(reason.startswith(DISAGREES) for reason in calibration.left_out.values())
    if agree >= _TRUSTED_SHARE * count:
        return ""
    return (
        f"only {agree} of {count} frames agree on where the arm's base is: the others' masks or the readings are "
        "wrong, or these few are"
    )


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


def _far_offsets(calibration: SessionCalibration, config: SessionConfig) -> list[str]:
    """Describe each offset that is beyond what cables do, or an insertion farther off than tools are, with causes.

    That of a joint whose readings are commanded values is no offset of its cables.
    """
    far_insertion = abs(calibration.offsets["insertion"]) > _LARGEST_INSERTION
    texts = [unusual_insertion(calibration, config)] if far_insertion else []
    std = np.degrees(np.sqrt(np.diag(calibration.covariance)[7:]))
    for (name, offset), own in zip(list(calibration.offsets.items())[1:], std.tolist(), strict=True):
        most = next((most for start, most in _BEYOND_CABLES_DEG.items() if name.startswith(start)), np.inf)
        if abs(np.degrees(offset)) > most + own and name not in calibration.commanded:
            texts.append(
                f"offset of {name}: {np.degrees(offset):+z.1f} deg (std {own:.1f}), where {most:.1f} deg are the most "
                f"that cables do; likely causes: {_CAUSES_OF_ROLL if name == 'roll' else _CAUSES_OF_CABLES}"
            )
    return texts


OF_SESSIONS: Final[Mapping[str, Callable[[SessionCalibration, SessionConfig], Sequence[str]]]] = {
    "predictions": lambda calibration, config: [bad_predictions(calibration)],
    "agreement": lambda calibration, config: [_few_agree(calibration)],
    "instrument": lambda calibration, config: [better_instrument(calibration.instruments, calibration.predicted_iou)],
    "shaft": lambda calibration, config: [] if calibration.shaft is None else calibration.shaft.contradictions(),
    "masks": lambda calibration, config: [_wide_masks(calibration)],
    "camera file": lambda calibration, config: _mistaken_camera(calibration),
    "camera": _wrong_camera,
    "camera test": lambda calibration, config: [_untested_camera(calibration)],
    "offsets": _far_offsets,
}
"""The table of sessions: what is tested, and why a session is doubtful; a text that is empty is no reason."""
