"""Drawings of an instrument on tissue or a drape, with typical image defects, and their true masks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

TISSUE = (70, 75, 165)  # BGR
DRAPE = (130, 110, 60)
STEEL, SHAFT = (150, 150, 148), (52, 50, 48)


@dataclass(frozen=True, eq=False)
class Drawing:
    """An image (H, W, 3) BGR and the mask of its instrument (H, W)."""

    image: np.ndarray
    mask: np.ndarray

    def overlap(self, mask: np.ndarray) -> float:
        """Give the intersection over union of a mask and the true one."""
        return float((mask & self.mask).sum() / max((mask | self.mask).sum(), 1))

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Bounding box of the mask."""
        rows, columns = np.nonzero(self.mask)
        return float(columns.min()), float(rows.min()), float(columns.max()), float(rows.max())

    def mirrored(self) -> Drawing:
        """Give the drawing with left and right exchanged."""
        return Drawing(np.ascontiguousarray(self.image[:, ::-1]), np.ascontiguousarray(self.mask[:, ::-1]))

    def enlarged(self, times: int) -> Drawing:
        """Give the drawing with ``times`` as many pixels in each direction."""
        size = self.image.shape[1] * times, self.image.shape[0] * times
        mask = cv2.resize(self.mask.astype(np.float32), size) > 0.5
        return Drawing(cv2.resize(self.image, size, interpolation=cv2.INTER_CUBIC), mask)

    def in_round_picture(self, radius: float) -> Drawing:
        """Give the drawing with a round field of view that does not fill the image."""
        v, u = np.indices(self.mask.shape)
        outside = np.hypot(u - self.mask.shape[1] / 2, v - self.mask.shape[0] / 2) > radius
        image = self.image.copy()
        image[outside] = np.random.default_rng(1).integers(0, 7, (int(outside.sum()), 3))
        return replace(self, image=image, mask=self.mask & ~outside)


def draw_tool(
    ground: tuple[int, int, int] = TISSUE, *, shadow: float = 0.0, vignette: float = 0.0, glare: int = 0, seed: int = 0
) -> Drawing:
    """Draw an instrument that enters from the left, 320 x 240 px.

    Parameters
    ----------
    ground
        Colour of the background, BGR.
    shadow
        Share of the light absorbed by a shadow beside the instrument.
    vignette
        Share of the light lost in the corners.
    glare
        Number of specular highlights.
    seed
        Seed of noise and highlights.
    """
    rng = np.random.default_rng(seed)
    fine, height, width = 4, 240, 320
    shaft, steel = (np.zeros((height * fine, width * fine), np.uint8) for _ in range(2))
    cv2.fillPoly(shaft, [np.array([[-40, 90], [170, 104], [170, 142], [-40, 136]]) * fine], 1)
    wrist = np.array([[168, 104], [205, 110], [210, 132], [168, 142]])
    jaws = (
        np.array([[204, 110], [262, 92], [264, 98], [212, 124]]),
        np.array([[206, 116], [256, 146], [250, 154], [202, 130]]),
    )
    for part in (wrist, *jaws):
        cv2.fillPoly(steel, [part * fine], 1)
    covers = [cv2.resize(p.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) for p in (shaft, steel)]
    folds = cv2.GaussianBlur(rng.standard_normal((height, width)).astype(np.float32), (0, 0), 12)
    image = np.array(ground, np.float32) * (1 + 0.25 * folds / np.abs(folds).max())[..., None]
    alpha = np.maximum(*covers)
    image *= (1 - shadow * cv2.GaussianBlur(np.roll(alpha, (12, 4), (0, 1)), (0, 0), 4))[..., None]
    v, u = np.indices((height, width))
    for _ in range(glare):
        at = rng.uniform((0, 0), (width, height))
        image[np.hypot(u - at[0], v - at[1]) < 3] = 250
    for cover, colour in zip(covers, (SHAFT, STEEL), strict=True):
        shine = 1 + 0.3 * np.cos((v - 112) / 9)[..., None]
        image = image * (1 - cover[..., None]) + np.array(colour, np.float32) * shine * cover[..., None]
    image *= 1 - vignette * ((u / width - 0.5) ** 2 + (v / height - 0.5) ** 2)[..., None] * 2
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 2, image.shape)
    return Drawing(np.clip(image, 0, 255).astype(np.uint8), alpha > 0.5)
