"""Segmentation by Segment Anything 2, from exported model files provided by the user.

The encoder runs once an image, the decoder once a prompt. The decoder returns a few candidate masks, each with a
predicted overlap (IoU) with the true mask; the candidate with the largest predicted overlap is used.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.geometry import Bool, Float32
from dvrk_cmaes.segment.sam2_exports import OFF, ON, Prompt, Role, Tensors
from dvrk_cmaes.segment.sam2_files import open_export
from dvrk_cmaes.segment.sam2_images import encoder_input, probability, resize_logits, to_square
from dvrk_cmaes.segment.segmentation import Box, Pixel, Segmentation, check_prompts


class Sam2:
    """An exported Segment Anything 2 or 2.1 model, loaded with onnxruntime.

    Parameters
    ----------
    weights
        Folder of the export's encoder and decoder, of any family in `dvrk_cmaes.segment.sam2_exports`.
    threads
        Number of threads, at least 1.

    Raises
    ------
    InputError
        No pair of files that can be used, or onnxruntime is not installed.
    """

    def __init__(self, weights: str | Path, threads: int = 2):
        if threads < 1:
            raise InputError(f"threads: expected a whole number of at least 1, got {threads}")
        self._export = open_export(Path(weights), threads)
        self._seen: tuple[bytes, Tensors] | None = None  # the last image's digest and features

    def segment(
        self,
        image: NDArray[np.uint8],
        *,
        box: Box | None = None,
        points: Sequence[Pixel] = (),
        not_points: Sequence[Pixel] = (),
    ) -> Segmentation:
        """Segment the object that all prompts together indicate.

        Parameters
        ----------
        image
            (H, W, 3) uint8, BGR. If it is the image of the last call, its features are not computed again.
        box
            Left, top, right, bottom of a box around the instrument, px.
        points, not_points
            Pixels (u, v) on the instrument, and pixels that are not.

        Returns
        -------
        Segmentation
            ``score`` is the probability of instrument at each pixel. ``confidence`` is the predicted IoU, or the
            predicted probability that there is an object at the prompt if the export gives it and it is less.

        Raises
        ------
        InputError
            No box and no point on the instrument, or prompts outside the image.
        DvrkCmaesError
            The model fails, or its outputs are not masks of finite values.
        """
        image = np.asarray(image)
        check_prompts(image, box, points, not_points)
        if box is None and not points:
            raise InputError("prompt: Segment Anything 2 needs a box or a point on the instrument, got neither")
        shape = (image.shape[0], image.shape[1])
        tensors = self._features(image) | self._export.family.prompt_inputs(_prompt(shape, box, points, not_points))
        outputs = self._export.decoder.run(tensors)
        masks, overlaps = self._output(outputs, "masks"), self._output(outputs, "overlaps").reshape(-1)
        best = self._best(overlaps)
        logits = masks if masks.dtype != np.bool_ else self._output(outputs, "logits")
        candidate = resize_logits(self._candidate(logits, best, len(overlaps)), shape)
        if masks.dtype == np.bool_ and masks.shape[-2:] == shape:
            mask = masks.reshape(-1, *shape)[best]
        else:
            mask = candidate > 0
        confidence, notes = self._trust(float(overlaps[best]), outputs, mask)
        return Segmentation(mask, probability(candidate), confidence, notes)

    def _features(self, image: NDArray[np.uint8]) -> Tensors:
        """Return the features of an image, from the last call if the image is the same."""
        digest = hashlib.blake2b(repr(image.shape).encode() + np.ascontiguousarray(image).tobytes()).digest()
        seen = self._seen
        if seen is None or seen[0] != digest:
            family, encoder = self._export.family, self._export.encoder
            outputs = encoder.run({family.image: encoder_input(image)})
            features = [encoder.output(outputs, key) for key in family.encoded]
            seen = self._seen = digest, dict(zip(family.features, features, strict=True))
        return seen[1]

    def _output(self, outputs: list[NDArray[Any]], role: Role) -> NDArray[Any]:
        """Return the decoder's output of a role; numbers as float32."""
        output = self._export.decoder.output(outputs, self._export.family.outputs[role])
        return output if output.dtype == np.bool_ else output.astype(np.float32)

    def _best(self, overlaps: Float32) -> int:
        """Return the index of the mask with the largest predicted overlap."""
        if not overlaps.size or not np.isfinite(overlaps).all():
            raise DvrkCmaesError(f"{self._export.decoder.file}: {_NOT_FINITE}")
        return int(np.argmax(overlaps))

    def _candidate(self, logits: Float32, best: int, count: int) -> Float32:
        """Return mask ``best``, (h, w), of an array (1, count, h, w) or (1, 1, count, h, w)."""
        if logits.ndim < 3 or logits.size != count * logits.shape[-2] * logits.shape[-1]:
            raise DvrkCmaesError(
                f"{self._export.decoder.file}: expected {count} masks, as many as overlaps, "
                f"got an array of {' x '.join(str(length) for length in logits.shape)}"
            )
        candidate = logits.reshape(count, *logits.shape[-2:])[best]
        if not np.isfinite(candidate).all():
            raise DvrkCmaesError(f"{self._export.decoder.file}: {_NOT_FINITE}")
        return np.asarray(candidate)

    def _trust(self, overlap: float, outputs: list[NDArray[Any]], mask: Bool) -> tuple[float, tuple[str, ...]]:
        """Return the confidence in a mask, 0 to 1, and notes for the user."""
        if not mask.any():
            return 0.0, ("the model found nothing at the prompt",)
        confidence = min(max(overlap, 0.0), 1.0)
        if "presence" not in self._export.family.outputs:
            return confidence, ()
        presence = float(probability(self._output(outputs, "presence")).reshape(-1)[0])
        doubt = f"the model doubts that there is an object at the prompt (probability {presence:.2f})"
        return min(confidence, presence), (doubt,) if presence < 0.5 else ()


_NOT_FINITE = "the model returned values that are not finite; use an export in float32"


@lru_cache(maxsize=1)
def load_sam2(weights: Path, threads: int) -> Sam2:
    """Load an export, or return it from the cache if it was the last one loaded; loading takes seconds."""
    return Sam2(weights, threads)


def segment_sam2(
    image: NDArray[np.uint8],
    weights: Path,
    threads: int,
    *,
    box: Box | None = None,
    points: Sequence[Pixel] = (),
    not_points: Sequence[Pixel] = (),
    otherwise: Callable[[], Segmentation],
) -> Segmentation:
    """Segment the instrument as `Sam2.segment` does; without a box or a point, by those of the ``classic`` mask.

    Its point is the one farthest from its outline.

    Parameters and errors are as in `Sam2` and `Sam2.segment`, except that without a prompt InputError is raised only if
    ``otherwise``, which returns the ``classic`` mask, finds no instrument.
    """
    model = load_sam2(weights, threads)
    if box is not None or points:
        return model.segment(image, box=box, points=points, not_points=not_points)
    from dvrk_cmaes.evidence.gather import window_around
    from dvrk_cmaes.segment.regions import distance_to

    guess = otherwise()
    if not guess.mask.any():
        raise InputError("prompt: Segment Anything 2 needs a box or a point; without one, classic found no instrument")
    left, top, width, height = window_around(guess.mask, margin=0)
    v, u = np.unravel_index(int(distance_to(~guess.mask).argmax()), guess.mask.shape)
    box = left, top, left + width - 1, top + height - 1
    segmentation = model.segment(image, box=box, points=[(float(u), float(v))], not_points=not_points)
    note = f"no prompt: asked by box and point of the classic segmentation (confidence {guess.confidence:.2f})"
    confidence = min(segmentation.confidence, guess.confidence)
    return replace(segmentation, confidence=confidence, notes=(note, *segmentation.notes))


def _prompt(shape: tuple[int, int], box: Box | None, points: Sequence[Pixel], not_points: Sequence[Pixel]) -> Prompt:
    """Scale prompts to the encoder's square; a box is clipped to the image's border."""
    height, width = shape
    pixels = np.array([*points, *not_points], np.float64).reshape(-1, 2)
    labels = np.array([ON] * len(points) + [OFF] * len(not_points), np.int64)
    corners = None
    if box is not None:
        cut = np.clip(np.array(box, np.float64).reshape(2, 2), 0, (width, height))
        corners = to_square(cut, shape).reshape(4)
    return Prompt(to_square(pixels, shape), labels, corners, shape)
