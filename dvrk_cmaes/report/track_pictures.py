"""What a recording's page takes from its frames: distances between mask and outline, and small pictures of some."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import cv2
import numpy as np

from dvrk_cmaes.draw.track_overlay import draw_outlines
from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.report.page_thumbnails import Thumbnail, encoded_thumbnail
from dvrk_cmaes.report.track_events import track_events
from dvrk_cmaes.results.tracked import TrackView

MEDIAN: Final = "median"
HIGH: Final = "95 %"
MOST_PICTURES: Final = 240
_WIDTH: Final = 256  # px
_LARGEST: Final = 9000  # bytes of a picture at a quality above the lowest
_NEAR: Final = (7, 7)  # px, within which distances are averaged
_MARGIN: Final = 2  # px around mask and silhouette


def chosen_frames(rows: Sequence[Mapping[str, Any]], most: int = MOST_PICTURES) -> list[int]:
    """Choose the frames that get a picture: those at which something happened first, then others at equal distances.

    Of more events than half of the pictures, evenly chosen ones count.
    """
    if len(rows) <= most:
        return list(range(len(rows)))
    places = sorted({k for event in track_events(rows) for k in (event.first, event.back) if k is not None})
    if len(places) > most // 2:
        places = [places[k] for k in np.linspace(0, len(places) - 1, most // 2).round().astype(int)]
    even = np.linspace(0, len(rows) - 1, most - len(places)).round().astype(int).tolist()
    return sorted({*places, *even})


class TrackPictures:
    """Gathers what a page needs of the frames of a recording, one after the other."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]) -> None:
        self._chosen = frozenset(chosen_frames(rows))
        self._medians, self._highs = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
        self.pictures: dict[int, Thumbnail] = {}

    @property
    def residuals(self) -> dict[str, Float64]:
        """Median and 95 % of the distances of the mask's contour from the outline, (F,) px, by name."""
        return {MEDIAN: self._medians, HIGH: self._highs}

    def add(self, number: int, views: Sequence[TrackView]) -> None:
        """Take what is needed of the frame of an index: the distances in all views, and a picture of them."""
        distances = [
            found
            for view in views
            if view.mask is not None
            and view.silhouette is not None
            and (found := contour_distances(view.mask, view.silhouette)) is not None
        ]
        if distances:
            self._medians[number], self._highs[number] = np.percentile(np.concatenate(distances), [50, 95])
        if number in self._chosen:
            count = len(views)
            self.pictures[number] = encoded_thumbnail(draw_outlines(views), count * _WIDTH, count * _LARGEST)


def contour_distances(mask: Bool, silhouette: Bool) -> Float64 | None:
    """Compute the distances (N,), px, of the pixels of a mask's contour (H, W) from a silhouette's outline (H, W).

    Each is the mean of those within some pixels along the contour, without which they would be whole pixels. Contour at
    the image's border does not count. Returns None if one of the two is empty or has no contour.
    """
    if not mask.any() or not silhouette.any():
        return None
    left, top, width, height = window_around(mask | silhouette, _MARGIN)
    window = np.s_[top : top + height, left : left + width]
    inside = mask[window].astype(np.uint8)
    contour = inside.astype(np.bool_) & (cv2.erode(inside, np.ones((3, 3), np.uint8)) == 0)
    rows, columns = np.nonzero(contour)
    within = (rows + top > 0) & (rows + top < mask.shape[0] - 1) & (columns + left > 0)
    within &= columns + left < mask.shape[1] - 1
    if not within.any() or silhouette[window].all():
        return None
    rows, columns = rows[within], columns[within]
    there, distances = np.zeros(inside.shape), np.zeros(inside.shape)
    there[rows, columns] = 1.0
    distances[rows, columns] = signed_distance(silhouette[window])[rows, columns] + 0.5
    mean = cv2.blur(distances, _NEAR)[rows, columns] / cv2.blur(there, _NEAR)[rows, columns]
    return np.asarray(np.abs(mean), np.float64)
