"""What a session's frames show besides the camera: the margin of the masks, and the instrument's sizes.

In a single frame a margin by which its mask is too wide or too narrow looks like a shorter distance. In a session
the arm moves along the optical axis by amounts that its joints state, and a margin makes near and far shafts wider by
the same number of pixels.

A larger instrument, as a whole or in shaft, wrist or jaws, looks like a smaller one nearby. The arm's readings
determine the distance of the remote centre and of the wrist, so a session distinguishes both, where the focal length of
the camera's file is right.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from dvrk_cmaes.calibration.blocks import (
    CLEAR,
    Calibration,
    FoundBlock,
    OutlineOfView,
    PredictedBlock,
    SeenBlock,
    TestedBlock,
    ViewAsSeen,
    square_by_file,
    with_mixture,
)
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.pose.doubts import OTHER_SIZES
from dvrk_cmaes.pose.refine.information import times
from dvrk_cmaes.pose.terms.coverage import of_margin
from dvrk_cmaes.pose.terms.shared_errors import NEAREST

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.model import SessionModel

MARGIN: Final = "margin"
"""Name of the block."""

_STD, _WIDE_SHARE = 1.0, 0.2  # px, of the prior, and the share of segmenters with it
_USUAL_STD = 0.05  # px, the same of the others, in images 640 px wide; recordings of `fleet.py make` show no more
_LEAST_STD = 0.12  # px; margins of parts of one real recording, 0.57 to 1.11, scatter by this and their errors
NEW_MASK = 0.08
"""Standard deviation, px, of the margin of a new mask, beyond what a session determines: a segmenter's threshold."""


class MaskMargin(SeenBlock):
    """The margin (1,), px, by which a segmenter makes all masks too wide, from where estimates ``start``.

    ``used`` is whether the session is solved with masks less the margin; ``pixel_scale`` is that of the camera.
    """

    shared = True
    is_alike = False

    def __init__(self, pixel_scale: float, start: float, *, used: bool) -> None:
        super().__init__(MARGIN, np.array([_STD]), np.array([start]))
        self.least_std, self.used, self._usual = np.array([_LEAST_STD]), used, np.array([_USUAL_STD * pixel_scale])

    def seen(self, by: ViewAsSeen, values: Float64) -> ViewAsSeen:
        """Return a view whose mask has the margin."""
        return replace(by, margin=by.margin + float(values[0]))

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of an outline's points by the margin."""
        return of_margin(outline.points)[:, None]

    def stated(self, alone: Float64, covariance: Float64) -> tuple[FoundBlock, Float64]:
        """State the margin, whose prior is a mixture."""
        priors = (1 - _WIDE_SHARE, self._usual), (_WIDE_SHARE, self.std)
        mean, square = with_mixture(alone, covariance + _LEAST_STD**2, priors)
        px, std = mean.item(), np.sqrt(np.diag(square) - mean**2)
        than, done = "wide" if px > 0 else "narrow", "corrected" if self.used else "left as they are"
        text = f"masks are {abs(px):.2f} px (std {std.item():.2f}) too {than} all round; {done}"
        found = FoundBlock.of((MARGIN,), (mean, std, self.std), text, applied=self.used)
        return found, square_left(found)


MARGIN_ALONE: Final = MaskMargin(1.0, 0.0, used=True)
"""The only block by which frames of a recording are fitted."""


def square_left(margin: FoundBlock) -> Float64:
    """Return the mean square (1, 1), px^2, of a margin that is left on masks of its session."""
    return np.square([margin.std]) + (0.0 if margin.applied else np.square([margin.values]))


def taken_off(margin: FoundBlock | None) -> float:
    """Return the margin, px, that is taken off the masks of a session which determines one, or None."""
    return margin.values[0] if margin is not None and margin.applied else 0.0


def covariance_of_margin(
    margin: FoundBlock | None, own: Float64, by_calibration: Float64 | None = None, *, new: float = NEW_MASK
) -> Float64:
    """Return the covariances (..., D, D) of poses by the margin of all masks of a session.

    Parameters
    ----------
    margin
        What the session determines of the margin; None where it was not estimated.
    own : (..., D)
        Changes of the poses by the margin of their own masks, px, given the calibration.
    by_calibration : (..., D, K)
        Changes of the poses with the calibration, which the same margin has moved; None if they do not rest on one.
    new
        Standard deviation of a further margin, px; zero for the masks of the session itself.
    """
    square, moves = new**2, own
    if margin is not None:
        square += square_left(margin).item()
        if by_calibration is not None and margin.moves:
            moves = own + (by_calibration @ margin.moves)[..., 0]
    return np.asarray(square * moves[..., :, None] * moves[..., None, :])


_PART_STD = 0.01  # of the logarithms, of parts of tools of one kind
_WIDE, _WEAK_SIZE = 0.05, 0.5  # of that of the whole, where outlines are linearised; where it is asked what is there
_OTHER_TOOL = 20.0  # standard deviations of what is known of a size, by which those of another tool differ
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


class Sizes(TestedBlock):
    """Logarithms (n,) of factors on ``sizes`` of the instrument; nothing is known of one that it lacks."""

    is_alike = widens = False
    sizes: ClassVar[tuple[str, ...]]

    def __init__(self, name: str, std: float, known: float) -> None:
        super().__init__(name, np.full(len(self.sizes), std))
        self.known, self.weak = np.full(len(self.sizes), known), np.full(len(self.sizes), _WEAK_SIZE)

    def stated(self, alone: Float64, covariance: Float64) -> tuple[FoundBlock, Float64]:
        """State the sizes that the frames fit, which are a doubt where they are those of another instrument."""
        std, parts, doubts = np.sqrt(np.diag(covariance)), [], []
        for part, value, spread in zip(self.sizes, alone.tolist(), std.tolist(), strict=True):
            (what, more, less), off, own = _TEXTS[part], 100 * np.expm1(value), 100 * np.exp(value) * spread
            parts.append(f"{part} {off:+z.1f} % (std {own:.1f})")
            if abs(off) > max(100 * _LEAST[part], CLEAR * own):
                than = more if off > 0 else less
                doubts.append(f"{what} {abs(off):.0f} % (std {own:.0f}) {than} than the instrument's")
        text, doubt = f"sizes of the instrument: {', '.join(parts)}", f"{' and '.join(doubts)}: {OTHER_SIZES}"
        found = FoundBlock.of(self.sizes, (alone, std, self.weak), text, doubt if doubts else "")
        return found, square_by_file(alone, covariance, self.known, range(len(alone)), _OTHER_TOOL)


class PartSizes(Sizes, SeenBlock):
    """Sizes of the instrument's parts: the shaft's radius, the length from the wrist's to the jaws' axis, the jaws'."""

    sizes = ("radius", "wrist", "jaws")

    def __init__(self, config: EstimateConfig, camera: Camera) -> None:
        super().__init__("parts", _PART_STD, _PART_STD)

    def effect(self, outline: OutlineOfView) -> Float64:
        """Return the displacements of the outline's points by each of the sizes."""
        points, camera, body = outline.points, outline.view.camera, outline.view.renderer.body.instrument
        seen = outline.at.seen_from(outline.view.view.view_from_camera)
        in_root = apply(body.forward(seen.joints)[points.link], points.points[:, None])[:, 0]
        placed, by_size = apply(seen.pose, in_root), np.stack(_moves(outline, in_root)) @ seen.pose[:3, :3].T
        depth = np.maximum(placed[:, 2:], NEAREST)
        across = (by_size[..., :2] - by_size[..., 2:] * placed[:, :2] / depth) * [camera.fx, camera.fy] / depth
        return np.asarray((points.normals * across).sum(axis=2).T)


def _moves(outline: OutlineOfView, in_root: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the moves (N, 3), m, by each size of a part, of an outline's points (N, 3) in the root's frame.

    They are zero by one of a part that a point is not on.
    """
    body, joints, links = outline.view.renderer.body.instrument, outline.at.joints, outline.points.link
    by_radius, by_wrist, by_jaws = (np.zeros_like(in_root) for _ in PartSizes.sizes)
    if (shaft := body.shaft) is not None:
        sides = outline.view.sides_of_shaft(outline.points, outline.at).any(axis=1)
        off = in_root[sides] - shaft.point
        by_radius[sides] = off - (off @ shaft.direction)[:, None] * shaft.direction
    if not (hinges := body.hinges):
        return by_radius, by_wrist, by_jaws
    first, last = body.chain.forward(joints, [hinges[0], hinges[-1]])[:, :3, 3]
    tips = [tip.link for tip in body.jaw_tips] or [len(body.links) - 1]
    ends = dict(zip(tips, body.ends(joints), strict=True))
    for link, joint in enumerate(body.link_joints):
        own, path = links == link, body.chain.path(joint)
        if hinges[-1] in path:
            by_wrist[own] = last - first
            if link in ends:
                by_jaws[own] = _stretched(in_root[own], last, ends[link])
        elif hinges[0] in path:
            by_wrist[own] = _stretched(in_root[own], first, last)
    return by_radius, by_wrist, by_jaws


class WholeSize(Sizes, PredictedBlock):
    """The size (1,) of the whole instrument: a larger one looks as that of the model does, nearer in proportion."""

    parameters = ("instrument_size",)
    sizes = ("whole",)

    def __init__(self, config: EstimateConfig, camera: Camera) -> None:
        super().__init__("size", _WIDE, config.camera.instrument_size_percent / 100)

    def change(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the changes of the roots' places to those where the model's instrument looks the same."""
        nearer = np.expm1(-calibration.values[self.name].item())
        return np.asarray(nearer * self._from_camera(model, calibration))

    def derivative(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the derivative of the changes by the logarithm of the size."""
        return -self.carried(self._from_camera(model, calibration)[:, :, None], calibration)

    def carried(self, derivative: Float64, calibration: Calibration) -> Float64:
        """Return the derivative by other blocks, of which the places of the roots are nearer in proportion."""
        nearer = np.exp(-calibration.values[self.name].item())
        return derivative * np.where(np.arange(derivative.shape[1]) < 3, nearer, 1.0)[:, None]

    def _from_camera(self, model: SessionModel, calibration: Calibration) -> Float64:
        """Return the roots' places (N, 6 + J) from the camera along their own axes, m, and zeros."""
        pose = model.predict(calibration.alone()).pose
        own = times(np.swapaxes(pose[:, :3, :3], 1, 2), pose[:, :3, 3])
        return np.pad(own, ((0, 0), (0, 3 + len(model.names))))


def _stretched(points: Float64, start: Float64, end: Float64) -> Float64:
    """Return by how much points (N, 3) move, where what is between two points becomes longer in proportion."""
    along = end - start
    share = (points - start) @ along / max(float(along @ along), NEAREST**2)
    return np.clip(share, 0.0, 1.0)[:, None] * along
