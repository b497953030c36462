"""Masks with one bit a pixel, small enough to be kept for many frames, and the overlap of two masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Bool


@dataclass(frozen=True)
class PackedMask:
    """A mask with one bit a pixel."""

    shape: tuple[int, int]
    bits: bytes

    @classmethod
    def of(cls, mask: Bool) -> PackedMask:
        """Pack a mask (H, W).

        Parameters
        ----------
        mask
            (H, W) bool.
        """
        return cls((mask.shape[0], mask.shape[1]), np.packbits(mask).tobytes())

    def restored(self) -> Bool:
        """Return the mask (H, W)."""
        height, width = self.shape
        bits = np.unpackbits(np.frombuffer(self.bits, np.uint8), count=height * width)
        return bits.reshape(height, width).astype(np.bool_)


def overlap_of(first: Bool, second: Bool) -> float:
    """Return the intersection over union of two masks; 1 if both are empty."""
    either = int((first | second).sum())
    return float((first & second).sum()) / either if either else 1.0
