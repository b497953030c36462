"""Masks of the instruments that are found in an image by their model.

The colours inside a candidate's silhouette and around it are learned, and a graph cut around the silhouette separates
them: close to it along the shaft, which is known well, and farther from it about wrist and jaws, whose angles are not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.frames.field_of_view import outside_view
from dvrk_cmaes.segment.by_model import Candidate, assumed_camera, find_instruments
from dvrk_cmaes.segment.classic import refine_outline
from dvrk_cmaes.segment.colours import Colours, ColourTable, measure_colours
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.segment.graph_cut import cut
from dvrk_cmaes.segment.prompts import Prompts, draw_prompts
from dvrk_cmaes.segment.regions import distance_to, fill_holes
from dvrk_cmaes.segment.segmentation import Hints, Segmentation
from dvrk_cmaes.segment.shaft_pairs import pair_of_mask
from dvrk_cmaes.segment.sizes import resized, shrunk, size_within
from dvrk_cmaes.silhouette import Body, Renderer

Bool = NDArray[np.bool_]
Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]

_SIZE: Final = 480  # px, longer side at which masks are cut
_FREE: Final = 0.12, 0.6  # widths of the shaft from the shaft, and from wrist and jaws, beyond which there is a prior
_STEEPNESS: Final = 6.0  # log-odds for each width beyond
_REACH: Final = 0.8, 1.5  # widths beyond, from which on nothing is instrument
_BESIDE: Final = 0.15, 3.0  # widths around a mask, between which the colours of the surroundings are learned
_LARGEST: Final = 3.0  # log-odds by the silhouette, and by the colours
_UNSEEN: Final = 0.05  # share of the instrument whose colours the silhouette does not show
_PASSES: Final = 2
_GAP: Final = 0.3  # widths between pieces of an instrument
_SMALLEST_PIECE: Final = 0.004  # of the largest piece's area
_AGREES: Final = 0.7  # overlap with a silhouette, from which on another mask is of the same instrument
_ALIKE: Final = 0.3  # overlap with any candidate, below which a mask has no likeness of an instrument
_UNLIKE: Final = 0.4  # confidence of such a mask
_UNDECIDED: Final = 0.75  # confidence, at most, of one of several instruments, where readings are of a certain one
_FITS_BOX: Final = 0.3  # least overlap of the bounding box of a silhouette with a given box


@dataclass(frozen=True, eq=False)
class ReducedImage:
    """An image at the size at which masks are cut: colours, their table, and what is known of its pixels."""

    colours: Colours
    table: ColourTable
    prompts: Prompts

    @staticmethod
    def of(image: Image, prompts: Prompts) -> ReducedImage:
        """Reduce an image (H, W, 3) uint8 BGR, and the prompts in its pixels."""
        size, scale = size_within(image.shape, _SIZE)
        colours = measure_colours(shrunk(image, _SIZE))
        return ReducedImage(colours, ColourTable(colours), prompts.resized(*size, scale))

    def mask_around(self, shaft: Bool, whole: Bool, width: float) -> Bool:
        """Cut out the instrument (h, w) around its silhouette.

        ``shaft`` and ``whole`` (h, w) are silhouettes of the shaft and of the whole instrument; ``width`` is that of
        the shaft, px. The silhouette is neither empty nor full.
        """
        distance = signed_distance(whole)
        at_shaft = distance_to(whole & ~shaft) > distance_to(shaft) + 1
        free = np.where(at_shaft, _FREE[0], _FREE[1]) * width
        beyond = np.sign(distance) * np.maximum(np.abs(distance) - free, 0)
        prior = np.clip(-_STEEPNESS / width * beyond, -_LARGEST, _LARGEST)
        never = distance > free + np.where(at_shaft, _REACH[0], _REACH[1]) * width
        unsure = ~at_shaft & (distance < _REACH[1] * width)  # may be wrist or jaws
        if self.prompts.background is not None:
            never |= self.prompts.background
        mask = whole
        for _ in range(_PASSES):
            away = distance_to(mask)
            around = (away > _BESIDE[0] * width) & (away < _BESIDE[1] * width) & ~unsure
            if self.prompts.outside is not None:
                around &= ~self.prompts.outside
            odds = np.clip(self.table.log_odds(mask, around, unseen=_UNSEEN), -_LARGEST, _LARGEST) + prior
            cutting = cut(np.asarray(odds, np.float32), self.colours.guide, background=never, tool=self.prompts.tool)
            mask = _near(fill_holes(cutting), whole, _GAP * width)
            if not mask.any() or mask.all():
                break
        return mask


def segment_by_model(
    image: Image,
    body: Body,
    camera: Camera | None,
    joints: Mapping[str, float] | None,
    hints: Hints,
    otherwise: Callable[[], Segmentation],
) -> Segmentation:
    """Find instruments in an image (H, W, 3) uint8 BGR by their model, and the mask of the best one.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    body, camera, joints
        The instrument, the camera (one as of most endoscopes is assumed without), and readings by name, rad.
    hints
        Prompts: the best instrument that fits them is taken.
    otherwise
        A function that finds a mask by other means. It is taken where it agrees with the instrument's silhouette, for
        its outline is finer, and where no instrument is found; there it is a guess, unless it has some likeness of one.
    """
    height, width = image.shape[:2]
    camera = assumed_camera(width, height) if camera is None else camera
    outside = outside_view(image)
    prompts = draw_prompts(image.shape, 1.0, hints.box, hints.points, hints.not_points).with_outside(outside)
    candidates = find_instruments(image, outside, body, camera, joints)
    found = [each for each in candidates if each.confidence >= GUESS and _fits(each, prompts, image)]
    other = otherwise()
    if not found:
        if prompts.given or other.confidence < GUESS or _is_alike(other.mask, candidates, body, camera):
            return other
        return replace(other, confidence=_UNLIKE, notes=("a guess", *other.notes, "its shape is not the instrument's"))
    reduced = ReducedImage.of(image, prompts)
    masks: list[Segmentation] = []
    for each in found if not prompts.given else found[:1]:
        sure = other.confidence >= GUESS and _overlap(each, other.mask) > _AGREES
        mask = other if sure else _segmentation(image, each, body, camera, prompts, reduced)
        if mask is not None and not any((mask.mask & former.mask).any() for former in masks):
            masks.append(mask)
    if not masks:
        return other
    first, others = masks[0], tuple(each for each in masks[1:] if each.confidence >= GUESS)
    if first.confidence < GUESS <= other.confidence:
        return other
    if not others:
        return first
    confidence = min(first.confidence, _UNDECIDED) if joints else first.confidence
    notes = *first.notes, _taken(first.mask, [each.mask for each in others])
    return replace(first, confidence=confidence, notes=notes, others=others)


def _is_alike(mask: Bool, candidates: Sequence[Candidate], body: Body, camera: Camera) -> bool:
    """Whether a mask (H, W) is like a candidate, or has straight sides as a shaft, blurred or not."""
    shaft = body.instrument.shaft
    sides = None if shaft is None else pair_of_mask(mask, camera, shaft.radius)
    return sides is not None or any(_overlap(each, mask) > _ALIKE for each in candidates)


def _overlap(found: Candidate, mask: Bool) -> float:
    """Return the intersection over union of a candidate's silhouette and a mask (H, W)."""
    height, width = found.silhouette.shape
    small = resized(mask, (width, height))
    return float((small & found.silhouette).sum() / max((small | found.silhouette).sum(), 1))


def _segmentation(
    image: Image, found: Candidate, body: Body, camera: Camera, prompts: Prompts, reduced: ReducedImage
) -> Segmentation | None:
    """Return the mask of a candidate in an image (H, W, 3), with its confidence; None if it is not in the picture."""
    instrument, (height, width) = body.instrument, reduced.colours.shape
    assert instrument.shaft is not None
    own = camera.scaled(width, height)
    root = Body(replace(instrument, links=instrument.links[:1], link_joints=instrument.link_joints[:1]))
    at = found.at[None]
    whole, shaft = (Renderer(drawn, own, threads=1).masks(at.pose, at.joints)[0] for drawn in (body, root))
    if not whole.any() or whole.all():
        return None
    across = 2 * instrument.shaft.radius * float(np.sqrt(own.fx * own.fy)) / found.at.pose[2, 3]
    rough = resized(reduced.mask_around(shaft, whole, across), (image.shape[1], image.shape[0]))
    mask = refine_outline(image, rough, prompts)
    return replace(mask, confidence=min(mask.confidence, found.confidence), before=None)


def _near(mask: Bool, silhouette: Bool, gap: float) -> Bool:
    """Keep the pieces of a mask (H, W) that overlap a silhouette, and those near them, px."""
    count, labels, measures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    meets = np.bincount(labels[distance_to(silhouette & mask) <= gap], minlength=count) > 0
    area = measures[:, cv2.CC_STAT_AREA]
    kept = meets & (area > _SMALLEST_PIECE * area[1:].max(initial=0))
    kept[0] = False
    return np.asarray(kept[labels])


def _fits(found: Candidate, prompts: Prompts, image: Image) -> bool:
    """Whether a candidate is where the prompts say: its silhouette has the points, or fills the box."""
    height, width = image.shape[:2]
    silhouette = cv2.resize(found.silhouette.astype(np.float32), (width, height)) > 0.5
    near = cv2.dilate(silhouette.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    if not all(near[round(v), round(u)] for u, v in prompts.points):
        return False
    if prompts.box is None or not silhouette.any():
        return True
    left, top, across, down = window_around(np.asarray(silhouette), 0)
    box = prompts.box
    common = max(min(box[2], left + across - 1) - max(box[0], left) + 1, 0.0)
    common *= max(min(box[3], top + down - 1) - max(box[1], top) + 1, 0.0)
    both = (box[2] - box[0] + 1) * (box[3] - box[1] + 1) + across * down - common
    return common > _FITS_BOX * both


def _taken(mask: Bool, others: Sequence[Bool]) -> str:
    """Return how many instruments there are, and which one's mask is taken."""
    number = ("two", "three", "four")[min(len(others), 3) - 1]
    places = np.array([np.argwhere(each).mean(axis=0)[::-1] for each in (mask, *others)])
    axis = int(np.ptp(places, axis=0).argmax())
    rank = int((places[1:, axis] < places[0, axis]).sum())
    names = (("left", "right"), ("upper", "lower"))[axis]
    which = names[0] if rank == 0 else names[1] if rank == len(others) else "middle"
    return f"{number} instruments, the {which} one taken (pass --point)"
