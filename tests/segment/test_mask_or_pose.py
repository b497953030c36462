"""Whether the mask or the pose is named as the cause of a doubt."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.drawn_tools import Drawing, draw_tool

from dvrk_cmaes.segment import Segmentation
from dvrk_cmaes.segment.mask_or_pose import CLEARLY, attribute_doubt, colours_side_with


@pytest.fixture(scope="module")
def drawing() -> Drawing:
    return draw_tool()


def without_end(mask: np.ndarray) -> np.ndarray:
    cut = mask.copy()
    cut[:, 190:] = False
    return cut


def test_incomplete_mask_is_named(drawing: Drawing) -> None:
    lacking = Segmentation(without_end(drawing.mask), None, 0.95)
    assert attribute_doubt(drawing.image, lacking, drawing.mask) == (
        "the mask is probably to blame: where it differs from the silhouette, the image's colours side with the "
        "silhouette"
    )


def test_mask_supported_by_image_is_not_named(drawing: Drawing) -> None:
    right = Segmentation(drawing.mask, None, 0.95)
    assert attribute_doubt(drawing.image, right, without_end(drawing.mask)) == (
        "the mask is probably not to blame: where the silhouette differs from it, the image's colours side with the "
        "mask; instrument, camera or readings may be wrong"
    )
    assert attribute_doubt(drawing.image, right, drawing.mask) == (
        "the mask is probably not to blame: the silhouette fits it, and the image bears it out"
    )


def test_colours_side_with_the_mask_that_is_right(drawing: Drawing) -> None:
    right, lacking = drawing.mask, without_end(drawing.mask)
    for_right, for_lacking = (colours_side_with(drawing.image, *pair) for pair in ((right, lacking), (lacking, right)))
    assert for_right is not None
    assert for_lacking is not None
    assert for_right > CLEARLY
    assert for_lacking < 1 - CLEARLY
    assert colours_side_with(drawing.image, right, right) is None
