"""What a tracker sees of an image: its evidence, and a mask where it has to be solved by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.segment import segment
from dvrk_cmaes.segment.confidence import GUESS
from dvrk_cmaes.segment.segmentation import Box, Hints
from dvrk_cmaes.track.colour_model import ColourModel
from dvrk_cmaes.track.evidence import BothEvidence, MaskEvidence, OutlineEvidence
from dvrk_cmaes.track.image_evidence import ImageEvidence, learned
from dvrk_cmaes.track.images import ImageCheck, Mask
from dvrk_cmaes.track.outline_model import Rim

Float64 = NDArray[np.float64]
Image = NDArray[np.uint8]
EvidenceKind = Literal["masks", "images", "both"]
KINDS: Final[tuple[EvidenceKind, ...]] = get_args(EvidenceKind)

_MARGIN = 0.04  # of the image's width, around an expected silhouette


@dataclass(frozen=True, eq=False)
class Seen:
    """The arrays of one image that are used, and whether they are those of the image before.

    ``problem`` is why the image says nothing about the pose, None if it may. ``given`` is the mask that was given, even
    where masks are not evidence: an image that is solved by itself is solved by it.
    """

    mask: Mask | None
    image: Image | None
    ignore: Mask | None
    problem: str | None
    same: bool
    given: Mask | None

    @property
    def source(self) -> str:
        """What the evidence is taken from, for messages."""
        return "image" if self.mask is None else "mask"


class Sight:
    """Turns the arrays of an image into evidence, and keeps the model of colours.

    ``kind`` is the evidence that is used; None for the mask of an image that has one, and else its colours. ``hints``
    state where the instrument is in the first image, if that is segmented.

    Raises
    ------
    InputError
        Another kind of evidence.
    """

    def __init__(self, camera: Camera, config: TrackConfig, kind: EvidenceKind | None, hints: Hints | None) -> None:
        if kind is not None and kind not in KINDS:
            raise InputError(f"evidence: expected one of {', '.join(nearest_first(str(kind), KINDS))}, got {kind!r}")
        self._check = ImageCheck(camera, config.black_level)
        self._config = config
        self._kind = kind
        self._hints = hints or Hints()
        self._colours: ColourModel | None = None

    def look(self, mask: Mask | None, image: Image | None, ignore: Mask | None) -> Seen:
        """Check the arrays of an image, and choose those that are used; InputError for one of another size."""
        for name, array in (("mask", mask), ("ignore", ignore), ("image", image)):
            self._check.check_size(name, array)
        used_mask = None if self._kind == "images" else mask
        used_image = None if self._kind == "masks" or (image is not None and image.ndim == 2) else image
        by_image = used_mask is None and used_image is not None
        problem = self._check.problem(used_mask, image, ignore, by_image=by_image)
        same = self._check.is_same(used_image if by_image else used_mask)
        return Seen(used_mask, used_image, ignore, problem, same, mask)

    def evidence(self, seen: Seen) -> OutlineEvidence | None:
        """Return the evidence of an image; None if it has no mask, and neither colours nor a mask are found in it."""
        if seen.mask is None and self._colours is None:
            found = self.mask(seen)
            return None if found is None else MaskEvidence(found, seen.ignore)
        by_mask = None if seen.mask is None else MaskEvidence(seen.mask, seen.ignore)
        if seen.image is None or self._colours is None or (by_mask is not None and self._kind != "both"):
            return by_mask
        by_colour = ImageEvidence(seen.image, self._colours, seen.ignore)
        return by_colour if by_mask is None else BothEvidence(by_mask, by_colour)

    def is_ready(self, seen: Seen) -> bool:
        """Whether an image has evidence without being segmented."""
        return seen.mask is not None or (seen.image is not None and self._colours is not None)

    def mask(self, seen: Seen, *, hinted: bool = False, around: Box | None = None) -> Mask | None:
        """Return the mask of an image, found by its colours if none was given; None if nothing is found, or a guess.

        If the image is ``hinted``, the hints hold for it. ``around`` is a box that holds the instrument where there are
        none.
        """
        if seen.given is not None or seen.image is None:
            return seen.given
        hints = self._hints if hinted else Hints()
        if hints == Hints() and around is not None:
            hints = Hints(box=around)
        found = segment(seen.image, box=hints.box, points=hints.points, not_points=hints.not_points)
        sure = hinted or found.confidence >= GUESS
        return found.mask if found.mask.any() and sure else None

    def learn(self, seen: Seen, pixels: Float64, rim: Rim, *, anew: bool) -> None:
        """Learn the colours of an image along an outline whose points are at ``pixels`` (N, 2).

        ``anew`` forgets the colours before.
        """
        if seen.image is None:
            return
        found = learned(seen.image, pixels, rim, seen.ignore)
        share = self._config.colour_share
        self._colours = found if anew or self._colours is None else self._colours.mixed(found, share)

    def box_of(self, rim: Rim) -> Box:
        """Return a box around an outline with a margin."""
        margin = _MARGIN * self._check.size[1]
        high = np.array(self._check.size[::-1]) - 1
        left, top = np.maximum(rim.all_pixels.min(axis=0) - margin, 0).tolist()
        right, bottom = np.minimum(rim.all_pixels.max(axis=0) + margin, high).tolist()
        return left, top, right, bottom

    def checkpoint(self) -> dict[str, Any]:
        """Return what is kept of the images so far as plain values."""
        colours = None if self._colours is None else self._colours.checkpoint()
        return {"last": self._check.last, "colours": colours}

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        self._check.last = None if saved["last"] is None else int(saved["last"])
        self._colours = None if saved["colours"] is None else ColourModel.restored(saved["colours"])
