"""The table of doubts: for which reasons a result of any command is not ok. `doubts` alone reads it.

A row is a rule: what is asked of which evidence, the limit, the text of the reason, and the results that it holds for.
The evidence is what its rules name of it: of a pose, `pose.judge` makes it, of a session `calibration.session_doubts`.
A rough mask alone is no reason: it makes the expected error larger, which counts once it is beyond the limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, Final, Literal

from dvrk_cmaes.camera.critical import WRONG, known_mistakes
from dvrk_cmaes.joints.sparse import MOST_OFF

Kind = Literal["alone", "solved", "followed", "edges", "confirmed", "live", "session"]
"""The results: of a frame by itself, and of one with its session; of an image that is followed by masks or by edges of
colours, or that a calibration whose lag is not told confirms; what is published; and a calibration."""

DISAGREES: Final = "disagrees with the session"
"""What the reason begins with for which a frame is left out that does not agree with the others."""
TIPS_NOT_ACCURATE: Final = "tips not accurate"
"""What the reason begins with for which the expected error of the tips is too large."""
OTHER_SIZES: Final = "another instrument (--instrument), or another focal length than the camera file's"
"""Why parts of an instrument may seem to have other sizes."""
PREDICTS_BADLY: Final = "this calibration predicts frames badly that it has not seen"
"""What the reason begins with for which a calibration is not used for other frames."""
BASE_APART: Final = "base far from the others'"
"""What the reason begins with for which a frame of a folder differs from the others."""

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
_CONVINCING, _MOST_BESIDE = 0.65, 0.2  # shares of the outline with an edge of the image, and with its colours beside it
SUPPORTED: Final = 0.35, 0.5
"""The least and the largest of these two shares with which an image supports a pose at all."""
MOST_ASTRAY: Final = 10
"""Images in a row that disagree with the calibration, after which it does not hold any more."""
CONFIRMING: Final = 5
"""Images that differ from each other and agree with an earlier calibration, from which on poses by it are ok."""
RELIED_ON: Final = 8
"""Keyframes of a solution, from which on its stated errors held; chosen on twelve recordings."""
_SLIP = 4.0  # standard deviations beyond which a joint's reading is reported
LARGEST_LOSS: Final = 0.15
"""Of the overlap, from the frames' own fits to their predictions by the others."""
_TRUSTED_SHARE = 0.5  # of the frames that were solved together; if no more agree, these few may be the wrong ones
LARGEST_PREDICTED_PX: Final = 2.5
"""Median distance of the contours of frames from what the other frames of their session predict, at 640 px of width."""
_LARGEST_MARGIN_PX = 2.0  # of all masks of a session
_LARGEST_SIDE_PX = 1.5
"""Standard deviation of the errors of a side of the shaft that last from frame to frame.

Shadows only add to masks, and the fits hardly show what they add in the mean. Of 77 recordings of
../shared/ruler/fleet.py (`scripts/measure.py track`, seeds 8605 to 8920) 76 have at most 0.73 px, and bases within
1.7 stated deviations; the other, 8720, has 2.65 px, masks 4.4 px too wide, and a base that is 4.0 deviations off. At
twice the size, 1280 x 960, that one has 2.36 px, and the next two, 8711 and 8809, have 0.93 and 1.13 px.
"""
_TELL_THE_CAMERA = 40
"""Number of frames of a right session by which an estimate of the camera does not run away.

It did so in 2 of 159 sessions of more than 30 frames, both wrong, and in 4 of 100 of 10 to 30, some of them right.
"""
_LARGEST_INSERTION = 10e-3  # m, beyond which tools of one kind do not differ
_BEYOND_CABLES_DEG = {"roll": 15.0, "wrist": 20.0, "jaw": 30.0}  # by the beginning of the joint's name


@dataclass(frozen=True)
class FrameLimits:
    """How far a frame may be from its mask and from what its session expects.

    what : what the frame belongs to, and what of it tells its pose, in words. factor : on the limits of contour, bend
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
_BY_EDGES: Final = replace(FOLLOWED, what="recording: the image")
LIMITS: Final[dict[Kind, FrameLimits]] = {"alone": _ONE, "solved": _ONE, "followed": FOLLOWED, "edges": _BY_EDGES}


@dataclass(frozen=True)
class Rule:
    """A row of the table: when a result is not ok.

    Attributes
    ----------
    of
        The evidence that is asked.
    holds
        The kinds of results that the rule holds for, divided by spaces.
    limit
        The limit, or the names of the attributes of the evidence that are it, as of settings, divided by spaces.
    asked
        Tells from evidence and limit whether there is a reason; a list has an item for each one.
    begins
        Words with which the reason may begin, divided by "|", where its text begins with a value.
    """

    of: str
    holds: str
    limit: Any
    asked: Callable[..., Any]
    begins: str = ""


_ANY: Final = True  # of what is there or not
_TURNED: Final = "trust.largest_view_deg trust.largest_view_sigmas"

RULES: Final[dict[str, Rule]] = {
    "overlap too low: IoU {e.quality.iou:.3f}, expected at least {limit[0]:.2f}": Rule(
        "view", "alone solved followed", "least_iou", lambda e, least: e.quality.iou < least
    ),
    "wrist or jaws off: beyond the shaft, the mask's contour is {e.quality.distal_px:.1f} px (rms) from the "
    "silhouette; another instrument, another tool or tissue may be there": Rule(
        "view",
        "alone solved followed",
        "largest_distal_px",
        lambda e, most: e.quality.distal_px > most,
    ),
    "mask cut straight: along a straight line that ends it, the silhouette bends by {e.quality.bend_px:.1f} px": Rule(
        "view", "alone solved followed", "largest_bend_px", lambda e, most: e.quality.bend_px > most
    ),
    "tip out of view: {limit[0]} outside the image": Rule(
        "view", "alone solved followed edges", "limits.outside", lambda e, which: e.is_outside
    ),
    f"{TIPS_NOT_ACCURATE}: their expected error is {{e.error.of_tips_mm:.1f}} mm, the probability that they are within "
    "{e.trust.tip_mm:g} mm {e.probability:.2f}": Rule(
        "view",
        "alone solved followed edges confirmed",
        "trust.least_probability",
        lambda e, least: e.probability < least,
    ),
    "views disagree: {it} fits {e.main} only from its other side: the images, masks or camera files of the two are "
    "exchanged": Rule(
        "eyes", "alone", _MIRRORED_OVERLAP, lambda e, most: [name for name, overlap in e.mirrored if overlap > most]
    ),
    "views disagree: {it[0]} fits {e.main} only if turned by {it[1]:.2f} deg; the rig may be calibrated wrongly, or "
    "the images are not of one time or exchanged": Rule(
        "frame",
        "alone",
        _TURNED,
        lambda e, deg, sigmas: [(name, turn) for name, turn, std in e.turned if turn >= deg and std >= sigmas],
    ),
    "tips in doubt: they are within {e.trust.tip_mm:g} mm with a probability of {e.probability:.2f}": Rule(
        "frame",
        "alone",
        "trust.least_probability",
        lambda e, least: e.probability < least <= e.if_right and e.of_mode >= _CERTAIN_MODE,
    ),
    "mode in doubt: the pose is in the right mode with a probability of {e.of_mode:.2f}; {e.rival}": Rule(
        "frame",
        "alone",
        "trust.least_probability",
        lambda e, least: e.probability < least and e.of_mode < _CERTAIN_MODE,
    ),
    "readings against outline: a pose farther from the readings explains the mask clearly better": Rule(
        "frame", "alone", "trust.largest_outline_gap", lambda e, most: e.outline_gap > most
    ),
    "no readings: nothing tells the pose from its mirror twin": Rule(
        "frame", "alone followed", _ANY, lambda e, least: e.joints_read < least
    ),
    "far from the readings: {it[0]} is {it[1]:.1f} times the expected error away": Rule(
        "frame",
        "alone",
        "trust.largest_reading_sigmas",
        lambda e, most: [(name, off) for name, off in e.off if off > most],
    ),
    "far from the readings: all joints together are farther off than readings are": Rule(
        "frame",
        "alone",
        "trust.largest_reading_sum trust.largest_reading_sigmas",
        lambda e, most, of_one: e.together > most and not any(off > of_one for _, off in e.off),
    ),
    "shaft not found: no two edges in the mask could bound it": Rule(
        "frame", "alone", _ANY, lambda e, least: e.has_shaft < least
    ),
    "points: {e.error_px:.1f} px rms from where the pose puts them": Rule(
        "points", "alone", "largest_px", lambda e, most: e.error_px > most
    ),
    "mask is a guess: confidence {e.confidence:.2f}, expected at least {limit[0]}": Rule(
        "picture", "alone", "guess", lambda e, least: e.confidence < least
    ),
    "mask or pose: {e.cause}": Rule("doubtful picture", "alone", _ANY, lambda e, least: e.cause),
    f"{BASE_APART}: rotated by {{e.angle:.0f}} deg, expected at most {{limit[0]:.0f}} deg; another mode, or wrong "
    "readings": Rule("folder", "alone", "most", lambda e, most: e.angle > most),
    "views disagree in {e.count} frames together: {e.name} fits the first view only if turned by {e.angle:.2f} deg "
    "({e.sigmas:.0f} standard deviations); the rig seems to be calibrated wrongly": Rule(
        "rig", "alone", _TURNED, lambda e, deg, sigmas: e.angle >= deg and e.sigmas >= sigmas
    ),
    # what a session's calibration expects of a frame
    "mask not explained: IoU {e.quality.iou:.3f}, {e.quality.contour_px_95:.1f} px at 95 % of the contour, expected "
    "at least {limit[0]:.3f} and at most {limit[1]:.1f} px": Rule(
        "agreement",
        "solved followed",
        "least_iou largest_px",
        lambda e, least, most: e.quality.iou < least or e.quality.contour_px_95 > most,
    ),
    "disagrees with the {e.limits.what} is {e.distance:.1f} times the expected error from what the calibration and the "
    "readings expect": Rule(
        "agreement", "solved followed edges", "config.largest_misfit", lambda e, most: not e.misfit <= most
    ),
    f"{DISAGREES}: what it expects does not explain the mask (IoU {{e.fit.iou:.2f}}, by itself "
    "{e.fit.own_iou:.2f})": Rule(
        "keyframe", "solved", "most", lambda e, most: e.misfit < most and not e.fit.explains_mask
    ),
    f"{DISAGREES}: {{e.distance:.1f}} times the expected error from what it expects": Rule(
        "keyframe", "solved", "most", lambda e, most: not e.misfit < most
    ),
    "reading of {it[0]}: {it[1]:.0f} deg off in this frame, beyond the session's offset": Rule(
        "slips", "solved", _SLIP, lambda e, most: [(name, deg) for name, deg, sigmas in e.errors if sigmas > most]
    ),
    "session: {it}": Rule("calibration", "solved followed", _ANY, lambda e, least: list(e.doubts)),
    # an image that is followed
    "lost: the {e.source} shows nothing of the instrument": Rule(
        "support", "followed", _ANY, lambda e, least: (e.iou is not None) < least
    ),
    "lost: the mask does not support the pose (IoU {e.iou:.2f})": Rule(
        "support", "followed", LEAST_OVERLAP, lambda e, least: e.iou is not None and e.iou < least
    ),
    "lost: {it}": Rule("support", "edges", SUPPORTED, lambda e, limit: not e.holds and "; ".join(e.doubts)),
    "outline without edge: {e.bare_percent:.0f} % of it has no edge of the image near it": Rule(
        "edges", "edges", _CONVINCING, lambda e, least: e.supported < least
    ),
    "colours without outline: the instrument's go on beside {e.beside_percent:.0f} % of it": Rule(
        "edges", "edges", _MOST_BESIDE, lambda e, most: e.beside > most
    ),
    "{e.percent:.0f} % of the silhouette are without the instrument's colours": Rule(
        "colours", "followed", UNSUPPORTED, lambda e, most: e.share > most, "N % of the silhouette"
    ),
    "joints far from the recording: {e.name} is {e.deg:+.0f} deg from what readings and calibration expect; something "
    "may hide the end of the instrument": Rule("joints", "followed", _FAR_JOINTS, lambda e, most: e.mean_square > most),
    "no readings: none of the outer joints at the time of the image less the lag": Rule(
        "readings", "followed", _ANY, lambda e, least: e.told < least
    ),
    "readings stand still: where the instrument is, only the {e.source} tells": Rule(
        "readings", "followed", _ANY, lambda e, least: e.told >= least and e.still
    ),
    "readings too sparse: {e.between}": Rule("spacing", "followed", MOST_OFF, lambda e, most: e.off > most),
    "readings frozen since frame {e.frozen}: the mask moves, and they do not": Rule(
        "mask and readings", "followed", _ANY, lambda e, least: e.frozen
    ),
    "calibration contradicted: {e.astray} images in a row disagree with it; the base or the camera may have "
    "moved": Rule("last image", "live", MOST_ASTRAY, lambda e, most: e.astray >= most),
    "checking an earlier calibration: {e.agreeing} of {limit[0]} images agree": Rule(
        "earlier calibration", "live", CONFIRMING, lambda e, least: e.agreeing is not None and e.agreeing < least
    ),
    "too few keyframes to rely on: base known to {e.tip_mm:.2g} mm, {e.keyframes} keyframes": Rule(
        "own calibration", "live", RELIED_ON, lambda e, least: e.keyframes < least
    ),
    "base known to {e.tip_mm:.2g} mm, {e.keyframes} keyframes": Rule(
        "base of tips", "live", "most", lambda e, most: e.std_mm is not None and e.std_mm > most
    ),
    "base not known yet: {e.kept} keyframes{e.known}": Rule("base", "live", _ANY, lambda e, least: e.bases < least),
    "no readings of the outer joints so far": Rule("base", "live", _ANY, lambda e, least: e.bases >= least),
    "not found: the first image could not be solved": Rule("search", "live", _ANY, lambda e, least: not e.search),
    "{it.stage}: the image of {it.images[0].time:.3f} s": Rule(
        "search", "live", _ANY, lambda e, least: e.search, "searching|segmenting"
    ),
    "searching: {e.waiting} images are followed to this one": Rule("following", "live", _ANY, lambda e, least: True),
    "black image: nothing can be seen": Rule("image", "live", "black_level", lambda e, least: e.brightest < least),
    "no mask: the pose is predicted": Rule("mask", "live", _ANY, lambda e, least: e.masks < least),
    "empty mask: the instrument is not in view": Rule("mask", "live", _ANY, lambda e, least: e.shown < least),
    "full mask: no edge can be seen": Rule("mask", "live", _ANY, lambda e, least: e.beside < least),
    "frozen image: the {e.source} is that of the image before, but the arm moved": Rule(
        "same image", "live", _ANY, lambda e, most: e.same >= most
    ),
    "the image is {e.age:.1f} s old": Rule("age", "live", "oldest", lambda e, most: e.age > most),
    # a session as a whole
    f"{PREDICTS_BADLY}: IoU {{e.predicted_iou:.2f}} by the other frames, {{e.iou:.2f}} by their own fits, contour "
    "{e.predicted_px:.1f} px off, expected at most {limit[1]:.1f} px; its lag, camera file, instrument or readings may "
    "be wrong": Rule(
        "session",
        "session",
        "largest_loss largest_px",
        lambda e, loss, px: e.predicted_iou < e.iou - loss or e.predicted_px > px,
    ),
    "only {e.agreeing} of {e.solved} frames agree on where the arm's base is: the others' masks or the readings are "
    "wrong, or these few are": Rule(
        "session", "session", _TRUSTED_SHARE, lambda e, least: e.agreeing <= least * e.solved
    ),
    "the lag leaves {e.unread} of {e.frames} frames without readings: it is wrong, or rows of readings are "
    "missing": Rule("session", "session", _TRUSTED_SHARE, lambda e, least: e.frames - e.unread <= least * e.frames),
    f"{{it}}: {OTHER_SIZES}": Rule(
        "session", "session", _ANY, lambda e, least: e.sizes, "the shaft is|the length from the wrist|the jaws are"
    ),
    "masks are {e.margin:.1f} px (std {e.masks.std_margin_px:.1f}) too {e.side} all round: more than segmenters err; "
    "another instrument, another focal length or masks that were widened have this effect": Rule(
        "session", "session", _LARGEST_MARGIN_PX, lambda e, most: e.margin > most * e.pixel_scale
    ),
    "masks err by {e.masks.side_px:.1f} px (std {e.masks.std_side_px:.1f}) on a side of the shaft, alike from frame to "
    "frame: base and depths may be off by more than is stated": Rule(
        "session",
        "session",
        _LARGEST_SIDE_PX,
        lambda e, most: e.masks is not None and (e.masks.side_px or 0) > most * e.pixel_scale,
    ),
    "{it}": Rule(
        "session", "alone session", _ANY, lambda e, least: known_mistakes(e.remarks), WRONG.removesuffix(": ")
    ),
    "the camera file is contradicted: {it}": Rule("session", "session", _ANY, lambda e, least: e.contradictions),
    "the camera file cannot be tested: many frames, which fit none that is plausible; their masks are wrong alike, the "
    "readings are, or the base moved": Rule(
        "session", "session", _TELL_THE_CAMERA, lambda e, least: e.implausible >= least
    ),
    "offset of insertion: {it}": Rule(
        "session", "session", _LARGEST_INSERTION, lambda e, most: e.insertion > most and e.unusual
    ),
    "offset of {it[0][0]}: {it[0][1]:+z.1f} deg (std {it[0][2]:.1f}), where {it[1]:.1f} deg are the most that cables "
    "do; likely causes: {it[0][3]}": Rule(
        "session",
        "session",
        _BEYOND_CABLES_DEG,
        lambda e, limits: [
            ((name, deg, std, causes), most)
            for name, deg, std, causes in e.offsets
            for start, most in limits.items()
            if name.startswith(start) and abs(deg) > most + std
        ],
    ),
    "lag between images and readings: {e.without_lag}": Rule(
        "session", "session", _ANY, lambda e, least: e.without_lag
    ),
}
"""The reasons, of the evidence ``e``, the limit and an item ``it`` of what the question found, each with its rule."""


def doubts(of: str, kind: Kind, evidence: object = None, **known: object) -> list[str]:
    """Return the reasons, in words, for which a result is not ok.

    Parameters
    ----------
    of
        What is judged, as the rules name it.
    kind
        The kind of the result.
    evidence, known
        What the rules ask, as attributes or by name.
    """
    asked = SimpleNamespace(**known) if evidence is None else evidence
    reasons: list[str] = []
    for text, rule in RULES.items():
        if rule.of == of and kind in rule.holds.split():
            names = rule.limit.split() if isinstance(rule.limit, str) else []
            limits = [attrgetter(name)(asked) for name in names] or [rule.limit]
            found = rule.asked(asked, *limits)
            items = found if isinstance(found, list) else [found] if found else []
            reasons += [text.format(e=asked, limit=limits, it=item) for item in items]
    return reasons
