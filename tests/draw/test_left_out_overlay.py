"""The picture of a leave-one-out prediction: positions and scale of the outlines, with images of any size."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.draw.canvas import Colour
from dvrk_cmaes.draw.left_out_overlay import PREDICTED, SIZE, draw_left_out
from dvrk_cmaes.draw.panels import MASK

WIDTH, HEIGHT = SIZE


def box(left: int, top: int, width: int, height: int, *, of: tuple[int, int] = (480, 640)) -> np.ndarray:
    """Give a mask (H, W) of one rectangle."""
    mask = np.zeros(of, dtype=bool)
    mask[top : top + height, left : left + width] = True
    return mask


def extent(picture: np.ndarray, colour: Colour) -> tuple[int, int, int, int]:
    """Give left, right, top and bottom of the pixels of a colour above the strip of text."""
    v, u = np.nonzero((np.abs(picture[:HEIGHT].astype(int) - colour) < 30).all(axis=2))
    return int(u.min()), int(u.max()), int(v.min()), int(v.max())


def test_outlines_share_scale_and_fill_picture() -> None:
    picture = draw_left_out(box(100, 300, 200, 100), box(140, 300, 200, 100), 0.6, 12.0)
    assert picture.shape[1] == WIDTH
    mask, predicted = extent(picture, MASK), extent(picture, PREDICTED)
    scale = (mask[1] - mask[0]) / 200
    assert scale > 2
    assert predicted[0] - mask[0] == pytest.approx(40 * scale, abs=3)
    assert predicted[1] - predicted[0] == pytest.approx(mask[1] - mask[0], abs=3)
    assert (mask[0] + predicted[1]) / 2 == pytest.approx(WIDTH / 2, abs=3)


@pytest.mark.parametrize("size", [(480, 640), (240, 320), (1024, 1280), (600, 300)])
def test_outline_lies_on_edge_in_image(size: tuple[int, int]) -> None:
    mask = box(size[1] // 4, size[0] // 4, size[1] // 2, size[0] // 2, of=size)
    image = np.where(mask[:, :, None], np.uint8(200), np.uint8(20)).repeat(3, axis=2)
    picture = draw_left_out(mask, mask, 1.0, 0.0, image=image)
    left, right, top, bottom = extent(picture, PREDICTED)
    middle = picture[(top + bottom) // 2, :, 0].astype(int)
    assert (middle[left - 6 : left - 3] < 40).all()
    assert (middle[left + 8 : right - 8] > 180).all()
    assert (middle[right + 3 : right + 6] < 40).all()


def test_image_size_does_not_move_outlines() -> None:
    mask = box(100, 200, 300, 150)
    large = np.zeros((960, 1280, 3), np.uint8)
    large[400:700, 200:800] = 220
    np.testing.assert_allclose(
        extent(draw_left_out(mask, mask, 1.0, 0.0, image=large), PREDICTED),
        extent(draw_left_out(mask, mask, 1.0, 0.0), PREDICTED),
    )


@pytest.mark.parametrize("predicted", [np.zeros((480, 640), bool), np.ones((480, 640), bool)])
def test_empty_and_full_predictions_are_drawn(predicted: np.ndarray) -> None:
    picture = draw_left_out(box(10, 10, 50, 40), predicted, 0.0, 800.0)
    assert extent(picture, MASK)[1] > extent(picture, MASK)[0]
    nothing = np.zeros_like(predicted)
    assert draw_left_out(nothing, nothing, 0.0, 800.0).shape == picture.shape
