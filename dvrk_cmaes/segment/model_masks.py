"""Masks of the instruments that are found in an image by their model.

The colours inside a candidate's silhouette and around it are learned, and a graph cut around the silhouette separates
them: close to it along the shaft, which is known well, and farther from it about wrist and jaws, whose angles are not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.frames.seen_view import overlap_of
from dvrk_cmaes.geometry import Bool, Float32, Image, Posed
from dvrk_cmaes.segment.around import mask_around, segmentation_around
from dvrk_cmaes.segment.by_model import Candidate, assumed_camera, find_instruments, rank
from dvrk_cmaes.segment.colours import ColourTable, measure_colours
from dvrk_cmaes.segment.prompts import Prompts
from dvrk_cmaes.segment.regions import FINEST, distance_to, resized, shrunk, size_within
from dvrk_cmaes.segment.segmentation import GUESS, Segmentation, nothing_found
from dvrk_cmaes.segment.shaft_pairs import pair_of_mask
from dvrk_cmaes.silhouette import Body, Renderer

_SIZE: Final = 480  # px, longer side at which masks are cut
_FURTHER: Final = 500  # px, longer side at most at which those of further instruments are moved to edges
_FREE: Final = 0.1, 0.7  # widths of the shaft from the shaft, and from wrist and jaws, beyond which there is a prior
_FREE_INSIDE: Final = 0.15  # widths from the outline of wrist and jaws, within it, likewise
_FREE_BEFORE: Final = 0.1, 0.25  # likewise, before a background that is known
_STEEPNESS: Final = 3.0  # log-odds for each width beyond
_REACH: Final = 0.15, 1.5  # widths beyond, from which on nothing is instrument
_AROUND: Final = 0.15, 3.0  # widths around a mask, between which the colours of the surroundings are learned
_LARGEST: Final = 4.0  # log-odds by the colours, which outweigh the silhouette: what lies before it is no instrument
_UNSEEN: Final = 0.2  # share of the instrument whose colours the silhouette does not show
_KNOWN: Final = 0.8, 2.0  # weights of the log-odds by these colours, where the outline is moved to the edges, and
_DEEP: Final = 2.0  # px within the first outline, beyond which the second weight holds: edges lose thin jaws
_LARGEST_BY_PROMPT: Final = 0.3  # of the picture, that colours about a prompt may take
_ALIKE: Final = 0.3  # overlap with any candidate, below which a mask has no likeness of an instrument
_ALIKE_BY_PROMPT: Final = 0.5  # likewise, with a prompt, with those that fit it
_UNLIKE: Final = 0.4  # confidence of such a mask
_POSSIBLE: Final = 0.1
"""Confidence of a candidate below which it is none: of 21 none is right there, of 21 from there to `GUESS` one."""
_AGREES: Final = 0.85  # overlap of a mask with the silhouette around which it was cut, below which it is less sure
_UNDECIDED: Final = 0.75  # confidence, at most, of one of several instruments, where readings are of a certain one
_SHARED: Final = 0.2  # of a mask, that may be in those of instruments that are surer; it is taken from this one
SAME: Final = 0.7  # overlap with an instrument, from which on a mask is of the same one: then the surer one is taken
_SURER: Final = 0.1  # by which the candidate's own mask is surer than that one, where it is taken
_ROUGHLY: Final = 0.2  # by which this overlap may be less at 320 px, where a mask is found at full size
_BEYOND_BOX: Final = 0.5  # share of a silhouette that is outside a given box


def _rough_mask(image: Image, shaft: Bool, whole: Bool, width: float, prompts: Prompts) -> tuple[Bool, Float32]:
    """Cut out the instrument (h, w) around a silhouette whose wrist and jaws may be off by much of the shaft's width.

    Also returns the log-odds (h, w) by the colours in the silhouette and around it.
    ``shaft`` and ``whole`` (h, w) are silhouettes of the shaft and of the whole instrument, neither empty nor full;
    ``width`` is that of the shaft, px.
    """
    at_shaft = distance_to(whole & ~shaft) > distance_to(shaft) + 1
    free, reach = (np.where(at_shaft, *of).astype(np.float32) * np.float32(width) for of in (_FREE, _REACH))
    free[whole] = np.minimum(free[whole], _FREE_INSIDE * width)
    unsure = ~at_shaft & (signed_distance(whole) < _REACH[1] * width)  # may be wrist or jaws
    away = distance_to(whole)
    surroundings = (away > _AROUND[0] * width) & (away < _AROUND[1] * width) & ~unsure & ~prompts.outside
    odds = ColourTable(measure_colours(image)).log_odds(whole, surroundings, unseen=_UNSEEN)
    odds = np.clip(odds, -_LARGEST, _LARGEST).astype(np.float32)
    found = mask_around(
        image,
        whole,
        free,
        reach=reach,
        steepness=_STEEPNESS / width,
        colours=odds,
        local=False,
        edges=False,
        prompts=prompts,
        passes=1,
    )
    return whole if found is None else found.mask, odds


def segment_by_model(
    image: Image,
    body: Body,
    camera: Camera | None,
    joints: Mapping[str, float] | None,
    prompts: Prompts,
    rough: Callable[[], Segmentation],
    otherwise: Callable[[], Segmentation],
    foreground: Float32 | None = None,
    expected: Posed | None = None,
) -> Segmentation:
    """Find instruments in an image (H, W, 3) uint8 BGR by their model, and the mask of the best one.

    Parameters
    ----------
    image
        (H, W, 3) uint8, BGR.
    body, camera, joints
        The instrument, the camera (one as of most endoscopes is assumed without), and readings by name, rad.
    prompts
        Prompts: the best instrument that fits them is taken.
    rough, otherwise
        Functions that find a mask by other means, at a reduced size, and at full size where that is no guess or no
        instrument is found. This mask is taken in place of that of a candidate which it shows, too, where it is surer.
        It is a guess itself, unless it has some likeness of an instrument. Where it is empty, the best candidate is
        taken as a guess.
    foreground
        (h, w), log-odds of instrument by a known background, by which candidates are chosen then and their masks cut;
        ``rough`` is what differs from that.
    expected
        Where the instrument is expected: the candidate nearest to that is taken.
    """
    camera = assumed_camera(image.shape[1], image.shape[0]) if camera is None else camera
    roughly = rough()
    sure = roughly.confidence >= GUESS
    about = roughly.mask if sure and roughly.mask.any() and not roughly.mask.all() else None
    candidates = find_instruments(image, prompts, body, camera, joints, about, foreground, expected)
    likely = candidates[: max((k for k, each in enumerate(candidates, 1) if each.confidence >= GUESS), default=0)]
    fitting = [each for each in candidates if _fits(each, prompts, image)]
    found = [each for each in fitting if each in likely] if expected is None else candidates[:1]

    @cache
    def by_colours() -> Segmentation:
        return _judged(otherwise(), fitting, prompts, body, camera)

    if not found:
        last, best = by_colours(), next(iter(fitting), None)
        sure_by_colours = last.mask.any() and (not prompts.given or last.confidence >= GUESS)
        if sure_by_colours or best is None or best.confidence < _POSSIBLE:
            return last
        own = mask_of_candidate(image, best, body, camera, prompts, foreground)
        return own if own.mask.any() else last
    shown = sure and foreground is None and any(_overlap(each, roughly.mask) > SAME - _ROUGHLY for each in found)
    other = by_colours() if shown else None

    def mask_of(each: Candidate, finest: int) -> Segmentation:
        """Return a candidate's mask without the pixels of others, whose colours may be this one's, too."""
        others = [one.silhouette & ~each.silhouette for one in likely if one is not each]
        others_pixels = resized(np.any([np.zeros_like(each.silhouette), *others], axis=0), image.shape[1::-1])
        same = None
        if other is not None and _overlap(each, other.mask) > SAME:
            same = replace(other, mask=other.mask & ~others_pixels) if others_pixels.any() else other
            if same.confidence > each.confidence:  # its own mask would be no surer than the candidate
                return same
        without = prompts.with_outside(prompts.outside | others_pixels)
        own = mask_of_candidate(image, each, body, camera, without, foreground, finest)
        return same if own.mask.any() and same is not None and same.confidence > own.confidence - _SURER else own

    masks, ranks, taken = list[Segmentation](), list[float](), np.zeros_like(prompts.outside)
    for each in found if not prompts.given else found[:1]:
        mask = mask_of(each, FINEST if all(one.confidence < GUESS for one in masks) else _FURTHER)
        if mask.mask.any() and (mask.mask & taken).sum() <= _SHARED * mask.mask.sum():
            masks.append(replace(mask, mask=mask.mask & ~taken) if taken.any() else mask)
            ranks.append(rank(each.score, mask.confidence))
            taken = taken | mask.mask
    if not masks:
        return by_colours()
    first, *others = (masks[k] for k in sorted(range(len(masks)), key=lambda k: -ranks[k]))
    if not others:
        return first
    confidence = min(first.confidence, _UNDECIDED) if joints else first.confidence
    notes = *first.notes, _taken(first.mask, [each.mask for each in others])
    return replace(first, confidence=confidence, notes=notes, others=tuple(others))


def _judged(
    other: Segmentation, candidates: Sequence[Candidate], prompts: Prompts, body: Body, camera: Camera
) -> Segmentation:
    """Return a mask by other means, as a guess where nothing is like an instrument; none that fills the picture.

    About a prompt it is one of a candidate there, or a guess: colours near a point may be those of tissue.
    """
    if prompts.given and other.mask.mean() > _LARGEST_BY_PROMPT:
        return nothing_found(other.mask.shape)
    least, shaft = _ALIKE_BY_PROMPT if prompts.given else _ALIKE, body.instrument.shaft
    if other.confidence < GUESS or any(_overlap(each, other.mask) > least for each in candidates):
        return other
    if not prompts.given and shaft is not None and pair_of_mask(other.mask, camera, shaft.radius):
        return other
    return replace(other, confidence=_UNLIKE, notes=(*other.notes, "its shape is not the instrument's"))


def _overlap(found: Candidate, mask: Bool) -> float:
    """Return the intersection over union of a candidate's silhouette and a mask (H, W)."""
    return overlap_of(found.silhouette, resized(mask, (found.silhouette.shape[1], found.silhouette.shape[0])))


def mask_of_candidate(
    image: Image,
    found: Candidate,
    body: Body,
    camera: Camera,
    prompts: Prompts,
    foreground: Float32 | None = None,
    finest: int = FINEST,
) -> Segmentation:
    """Return the mask of a candidate in an image (H, W, 3), with its confidence; empty if it is not in the picture.

    Without a ``foreground``, its outline is moved to the edges of the image at up to ``finest`` px.
    """
    instrument = body.instrument
    assert instrument.shaft is not None
    size, scale = size_within(image.shape, _SIZE if foreground is None else FINEST)
    own = camera.scaled(*size)
    root = Body(replace(instrument, links=instrument.links[:1], link_joints=instrument.link_joints[:1]))
    at = found.at[None]
    whole, shaft = (Renderer(drawn, own, threads=1).masks(at.pose, at.joints)[0] for drawn in (body, root))
    if not whole.any() or whole.all():
        return nothing_found(image.shape)
    across = 2 * instrument.shaft.radius * float(np.sqrt(own.fx * own.fy)) / found.at.pose[2, 3]
    if foreground is None:
        rough, odds = _rough_mask(shrunk(image, _SIZE), shaft, whole, across, prompts.resized(*size, scale))
        known = np.where(distance_to(~rough) > _DEEP, _KNOWN[1], _KNOWN[0]).astype(np.float32) * odds
        rough = resized(rough, (image.shape[1], image.shape[0]))
        mask = segmentation_around(image, rough, prompts, rough=True, colours=known, finest=finest)
    else:
        at_shaft = distance_to(whole & ~shaft) > distance_to(shaft) + 1
        free = np.where(at_shaft, *_FREE_BEFORE).astype(np.float32) * np.float32(across)
        whole = resized(whole, (image.shape[1], image.shape[0]))
        mask = segmentation_around(image, whole, prompts, colours=foreground, local=False, free=free)
    agreed = min(_overlap(found, mask.mask) / _AGREES, 1.0)
    if foreground is not None:  # dark before dark, colours and edges say little
        return replace(mask, confidence=agreed * (mask.confidence + found.confidence) / 2, notes=())
    return replace(mask, confidence=agreed * min(mask.confidence, found.confidence), before=None)


def _fits(found: Candidate, prompts: Prompts, image: Image) -> bool:
    """Whether a candidate is where the prompts say: its silhouette has the points, and is in the box."""
    if not prompts.given:
        return True
    silhouette = resized(found.silhouette, image.shape[1::-1])
    near = cv2.dilate(silhouette.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    if not all(near[round(v), round(u)] for u, v in prompts.points):
        return False
    beyond = silhouette & prompts.background & ~prompts.outside
    return prompts.box is None or int(beyond.sum()) < _BEYOND_BOX * int(silhouette.sum())


def _taken(mask: Bool, others: Sequence[Bool]) -> str:
    """Return how many instruments there are, and which one's mask is taken."""
    number = ("two", "three", "four")[min(len(others), 3) - 1]
    places = np.array([np.argwhere(each).mean(axis=0)[::-1] for each in (mask, *others)])
    axis = int(np.ptp(places, axis=0).argmax())
    rank = int((places[1:, axis] < places[0, axis]).sum())
    names = (("left", "right"), ("upper", "lower"))[axis]
    which = names[0] if rank == 0 else names[1] if rank == len(others) else "middle"
    return f"{number} instruments, the {which} one taken (pass --point)"
