"""What a session's frames show of two unknowns besides the camera: the margin of the masks, and the instrument's sizes.

In a single frame a margin by which its mask is too wide or too narrow looks like a shorter distance. In a session
the arm moves along the optical axis by amounts that its joints state, and a margin makes near and far shafts wider by
the same number of pixels.

A larger instrument, as a whole or in shaft, wrist or jaws, looks like a smaller one nearby. The arm's readings
determine the distance of the remote centre and of the wrist, so a session distinguishes both, where the focal length of
the camera's file is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from dvrk_cmaes.calibration.blocks import CLEAR, Calibration, FoundBlock, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import ArmOutlines, Linearised, linearise, with_mixture
from dvrk_cmaes.calibration.solve import marginalise
from dvrk_cmaes.config import CameraConfig, SessionConfig
from dvrk_cmaes.geometry import Float64, Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Number
from dvrk_cmaes.pose.doubts import OTHER_SIZES
from dvrk_cmaes.pose.terms.coverage import of_margin
from dvrk_cmaes.pose.terms.shared_errors import NEAREST
from dvrk_cmaes.silhouette import OutlinePoints

MARGIN: Final = "margin"
"""Name of the block."""

_STD, _WIDE_SHARE = 1.0, 0.2  # px, of the prior, and the share of segmenters with it
_USUAL_STD = 0.05  # px, the same of the others, in images 640 px wide; recordings of `fleet.py make` show no more
_FREE = 100.0  # px, of a prior that does not count
_LEAST_STD = 0.12  # px; margins of parts of one real recording, 0.57 to 1.11, scatter by this and their errors
_PASSES = 5  # largest number of linearisations
_HELD = 1e-3  # of the prior standard deviations of a camera that is held at its file
_MARGIN_PX = 0.08  # of all masks, beyond what the keyframes determine: rounded corners, a segmenter's threshold


class MaskMargin(SeenBlock):
    """The margin (1,), px, by which a segmenter makes all masks too wide, from where estimates ``start``."""

    shared = True

    def __init__(self, start: float = 0.0) -> None:
        super().__init__(MARGIN, np.array([_STD]), np.array([start]))
        self.least_std = np.array([_LEAST_STD])

    def seen(self, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view whose mask has the margin."""
        return replace(by, margin=by.margin + float(values[0]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the margin."""
        return of_margin(outline.points)[:, None]


class MarginEffect(NamedTuple):
    """What a margin of all masks does, per px: to the K unknowns of a calibration (K,), and to N frames' poses (N, D).

    ``px`` and ``std_px`` are the margin that the same outlines show.
    """

    px: float
    std_px: float
    of_calibration: Float64
    of_frames: Float64

    @classmethod
    def of(cls, there: Linearised) -> MarginEffect:
        """Return it by outlines that were linearised with the margin among the blocks."""
        calibration, count = there.solution.calibration, there.solution.calibration.own
        place, of_calibration = calibration.place(MARGIN), -there.moved_by(MARGIN)
        frames = marginalise(there.model, there.fits, calibration)
        by_all = frames.gain @ there.model.jacobian(calibration)
        of_frames = by_all[:, :, :count] @ of_calibration - by_all[:, :, place]
        std = np.hypot(np.sqrt(there.covariance[place, place].item()), _LEAST_STD)
        return cls(there.value(MARGIN).item(), float(std), of_calibration[:, 0], of_frames[:, :, 0])

    def stated(self, masks: SessionMasks | None) -> SessionMasks:
        """Return what is stated of the masks with this effect, whose margin is left as it is where none is stated."""
        known = SessionMasks(self.px, self.std_px, applied=False) if masks is None else masks
        return replace(known, by_margin=tuple(self.of_calibration.tolist()))


@dataclass(frozen=True)
class SessionMasks(Document):
    """What a session's frames determine of the margin of its masks.

    margin_px : by how much the masks are too wide all round; negative if too narrow. std_margin_px : its standard
    deviation. applied : whether the session was solved with masks less this margin. In a session of several views it is
    estimated in the first one.
    by_margin : what the margin, per px, does to the calibration, in the order of its covariance.
    """

    margin_px: Number
    std_margin_px: Number
    applied: bool
    by_margin: tuple[Number, ...] = ()

    @property
    def square(self) -> float:
        """Mean square, px^2, of the margin that is left on masks of this session."""
        return self.std_margin_px**2 + (self.margin_px - self.taken_off) ** 2

    @property
    def taken_off(self) -> float:
        """Margin, px, that was taken off the masks."""
        return self.margin_px if self.applied else 0.0

    def after(self, change: Float64) -> SessionMasks:
        """Return the same for a calibration that is a linear function (K', K) of this session's.

        Parameters
        ----------
        change
            The matrix of that function.
        """
        return replace(self, by_margin=tuple((change @ self.by_margin).tolist())) if self.by_margin else self

    def describe(self) -> str:
        """Describe the margin in words."""
        than, done = "wide" if self.margin_px > 0 else "narrow", "taken off" if self.applied else "left as they are"
        return f"masks are {abs(self.margin_px):.2f} px (std {self.std_margin_px:.2f}) too {than} all round; {done}"


def estimate_margin(
    arms: Sequence[ArmOutlines], config: SessionConfig
) -> tuple[SessionMasks, list[tuple[Calibration, Posed]]]:
    """Estimate the margin of the masks with the calibrations and the camera, whose file counts as a measurement.

    Arguments are as in `linearise`; the outlines are those of one view, with the margin among their blocks. Also
    returns the calibration and the poses (N) of each arm with masks less the margin and the camera of the file: a
    change of the camera that is estimated jointly with the margin is not used.
    """
    there, moved = linearise(arms, config, [MARGIN], passes=_PASSES), []
    place, camera = there[0].solution.calibration.place(MARGIN), arms[0].camera
    shown, spread = there[0].with_std({MARGIN: _FREE})
    priors = (1 - _WIDE_SHARE, np.array([_USUAL_STD * camera.pixel_scale])), (_WIDE_SHARE, np.array([_STD]))
    mean, square = with_mixture(shown[place], spread[place, place] + _LEAST_STD**2, priors)
    px, std = mean.item(), float(np.sqrt(square.item() - mean.item() ** 2))
    for one, arm in zip(there, arms, strict=True):
        held = {block.name: _HELD * block.std for block in arm.blocks if block.name != MARGIN}
        at_file = one.solution.calibration
        at_file = at_file.changed(one.with_std(held)[0] - np.append(np.zeros(at_file.own), at_file.further))
        poses = marginalise(one.model, one.fits, at_file).own
        moved.append((at_file.alone(), one.fits.at.moved(poses)))
    return SessionMasks(px, std, applied=True), moved


def covariance_of_margin(masks: SessionMasks | None, own: Float64, by_calibration: Float64 | None = None) -> Float64:
    """Return the covariance (D, D) of a pose by the margin of all masks of a session.

    Parameters
    ----------
    masks
        What the session determines of the margin; None where it was not estimated.
    own : (D,)
        Change of the pose by the margin of its own mask, px, given the calibration.
    by_calibration : (D, K)
        Changes of the pose with the calibration, which the same margin has moved; None if it does not rest on one.
    """
    square, moves = _MARGIN_PX**2, own
    if masks is not None:
        square += masks.square
        if by_calibration is not None and masks.by_margin:
            moves = own + by_calibration @ masks.by_margin
    return np.asarray(square * np.outer(moves, moves))


SIZES = "sizes"
"""Name of the block."""

_PART_STD = 0.01  # of the logarithms, of parts of tools of one kind
_WIDE = np.array([_PART_STD, _PART_STD, _PART_STD, 0.05])  # where the outlines are linearised
_WEAK_SIZE = 0.5  # of the same where it is asked which tool is there
_LEAST: Final = {"radius": 0.02, "wrist": 0.04, "jaws": 0.04, "whole": 0.02}
"""Shares of the sizes, beyond which whole or part is another one.

Right ones are found to 0.5 %, lengths to 1 % in recordings of `fleet.py make` and sessions of `synth`, seeds 7701 to
7704 (`scripts/measure.py track`, `calibrate`). Of 79 recordings of `fleet.py make` with the right instrument the shaft
of one is beyond it (seeds 8605 to 8919), as its masks are 3 px too wide on one side.
"""
_TEXTS: Final = {
    "radius": ("the shaft is", "thicker", "thinner"),
    "wrist": ("the length from the wrist's to the jaws' axis is", "longer", "shorter"),
    "jaws": ("the jaws are", "longer", "shorter"),
    "whole": ("all of it is", "larger", "smaller"),
}


def usual_sizes(config: CameraConfig) -> Float64:
    """Return the standard deviations (4,) of the logarithms that tools of one kind have."""
    return np.array([_PART_STD] * 3 + [config.instrument_size_percent / 100])


class InstrumentSizes(SeenBlock):
    """The logarithms (4,) of factors on shaft's radius, length from wrist to jaws' axis, jaws' length, and the whole.

    Only the whole is drawn with the size that is estimated. Nothing is known of a size that the instrument lacks.
    """

    is_linear = True, True, True, False

    def __init__(self, instrument: Instrument) -> None:
        super().__init__(SIZES, _WIDE)
        self._instrument = instrument

    def seen(self, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view of an instrument that is larger as a whole."""
        return replace(by, scale=by.scale * float(np.exp(values[-1])))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of the outline's points by each of the sizes."""
        view, points = outline.view, outline.points
        seen = outline.at.seen_from(view.view.view_from_camera)
        poses = self._instrument.forward(seen.joints)[points.link]
        in_root = (poses[:, :3, :3] @ points.points[:, :, None])[..., 0] + poses[:, :3, 3]
        depth = np.maximum(apply(seen.pose, in_root)[:, 2], NEAREST)
        out = np.zeros((len(depth), len(_LEAST)))
        if self._instrument.shaft is not None:
            sides = view.sides_of_shaft(points, outline.at).sum(axis=1)
            length = np.linalg.norm(points.normals, axis=1)
            out[:, 0] = sides * length * view.camera.fx * self._instrument.shaft.radius / depth
        for k, moves in enumerate((*self._moves(points, in_root, seen), in_root), start=1):
            by_size = moves @ seen.pose[:3, :3].T
            across = by_size[:, :2] - by_size[:, 2:] * (apply(seen.pose, in_root)[:, :2] / depth[:, None])
            out[:, k] = (points.normals * across * [view.camera.fx, view.camera.fy]).sum(axis=1) / depth
        return out

    def _moves(self, points: OutlinePoints, in_root: Float64, seen: Posed) -> tuple[Float64, Float64]:
        """Return the moves of points (N, 3) in the root's frame, m, by the wrist's length and by the jaws'."""
        body = self._instrument
        hinges = body.hinges
        by_wrist, by_jaws = np.zeros_like(in_root), np.zeros_like(in_root)
        if not hinges:
            return by_wrist, by_jaws
        first, last = body.chain.forward(seen.joints, [hinges[0], hinges[-1]])[:, :3, 3]
        tips = [tip.link for tip in body.jaw_tips] or [len(body.links) - 1]
        ends = dict(zip(tips, body.ends(seen.joints), strict=True))
        for link, joint in enumerate(body.link_joints):
            own, path = points.link == link, body.chain.path(joint)
            if hinges[-1] in path:
                by_wrist[own] = last - first
                if link in ends:
                    by_jaws[own] = _stretched(in_root[own], last, ends[link])
            elif hinges[0] in path:
                by_wrist[own] = _stretched(in_root[own], first, last)
        return by_wrist, by_jaws


def _stretched(points: Float64, start: Float64, end: Float64) -> Float64:
    """Return by how much points (N, 3) move, where what is between two points becomes longer in proportion."""
    along = end - start
    share = (points - start) @ along / max(float(along @ along), NEAREST**2)
    return np.clip(share, 0.0, 1.0)[:, None] * along


def found_sizes(there: Linearised, known: Mapping[str, Float64 | float]) -> FoundBlock:
    """State the sizes that the frames fit: radius, wrist and jaws of an instrument whose whole is known, and the whole.

    Parameters
    ----------
    there
        Outlines that were linearised in the sizes.
    known
        Standard deviations of priors, also of the sizes, by block.
    """
    place, of_whole = there.solution.calibration.place(SIZES), np.array([name == "whole" for name in _LEAST])
    values, std = np.zeros(len(_LEAST)), np.zeros(len(_LEAST))
    for asked in (~of_whole, of_whole):
        found, covariance = there.with_std({**known, SIZES: np.where(asked, _WEAK_SIZE, known[SIZES])})
        values[asked], std[asked] = found[place][asked], np.sqrt(np.diag(covariance)[place])[asked]
    parts, doubts = [], []
    for (part, least), value, spread in zip(_LEAST.items(), values.tolist(), std.tolist(), strict=True):
        (what, more, less), off, own = _TEXTS[part], 100 * np.expm1(value), 100 * np.exp(value) * spread
        parts.append(f"{part} {off:+z.1f} % (std {own:.1f})")
        if abs(off) > max(100 * least, CLEAR * own):
            than = more if off > 0 else less
            doubts.append(f"{what} {abs(off):.0f} % (std {own:.0f}) {than} than the instrument's")
    text, doubt = f"sizes of the instrument: {', '.join(parts)}", f"{' and '.join(doubts)}: {OTHER_SIZES}"
    return FoundBlock.of(tuple(_LEAST), (values, std, np.full(len(_LEAST), _WEAK_SIZE)), text, doubt if doubts else "")


def square_of_whole(found: FoundBlock, std: float) -> float:
    """Return the mean square of the error of the log of the whole size, whose prior has a deviation ``std``."""
    value, own = found.values[-1], found.std[-1]
    share = std**2 / (std**2 + own**2)
    return (share * value) ** 2 + share * own**2
