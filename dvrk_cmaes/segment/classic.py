"""The instrument in an image by its colours, edges and place, without weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.segment.segmentation import Box, Pixel, Segmentation


def segment_classic(
    image: NDArray[np.uint8],
    *,
    box: Box | None = None,
    points: Sequence[Pixel] = (),
    not_points: Sequence[Pixel] = (),
) -> Segmentation:
    """Find the instrument in an image (H, W, 3) uint8 BGR, with prompts as in `dvrk_cmaes.segment.segment`."""
    raise NotImplementedError
