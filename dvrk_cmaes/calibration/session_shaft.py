"""What a session's frames show of the sizes of the instrument: of the whole, its shaft, its wrist and its jaws.

A larger instrument looks like a smaller one nearby. The arm's readings determine the distance of the remote centre and
of the wrist, so a session distinguishes both, where the focal length of the camera's file is right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import CLEAR, FoundBlock, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.linearise import Linearised
from dvrk_cmaes.config import CameraConfig
from dvrk_cmaes.geometry import Float64, Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.doubts import OTHER_SIZES
from dvrk_cmaes.pose.terms.shared_errors import NEAREST
from dvrk_cmaes.silhouette import OutlinePoints

SIZES = "sizes"
"""Name of the block."""

_PART_STD = 0.01  # of the logarithms, of parts of tools of one kind
_WIDE = np.array([_PART_STD, _PART_STD, _PART_STD, 0.05])  # where the outlines are linearised
_WEAK_STD = 0.5  # of the same where it is asked which tool is there
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

    def seen(self, name: str, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
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
        found, covariance = there.with_std({**known, SIZES: np.where(asked, _WEAK_STD, known[SIZES])})
        values[asked], std[asked] = found[place][asked], np.sqrt(np.diag(covariance)[place])[asked]
    parts, doubts = [], []
    for (part, least), value, spread in zip(_LEAST.items(), values.tolist(), std.tolist(), strict=True):
        (what, more, less), off, own = _TEXTS[part], 100 * np.expm1(value), 100 * np.exp(value) * spread
        parts.append(f"{part} {off:+z.1f} % (std {own:.1f})")
        if abs(off) > max(100 * least, CLEAR * own):
            than = more if off > 0 else less
            doubts.append(f"{what} {abs(off):.0f} % (std {own:.0f}) {than} than the instrument's")
    text, doubt = f"sizes of the instrument: {', '.join(parts)}", f"{' and '.join(doubts)}: {OTHER_SIZES}"
    return FoundBlock.of(tuple(_LEAST), (values, std, np.full(len(_LEAST), _WEAK_STD)), text, doubt if doubts else "")


def square_of_whole(found: FoundBlock, std: float) -> float:
    """Return the mean square of the error of the log of the whole size, whose prior has a deviation ``std``."""
    value, own = found.values[-1], found.std[-1]
    share = std**2 / (std**2 + own**2)
    return (share * value) ** 2 + share * own**2
