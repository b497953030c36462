"""Likelihood of a picture given a silhouette: how far its parts look unlike their surroundings, and have edges.

Pixels are sorted into bins by colour and texture. Of a candidate pose, the histograms of the shaft, of wrist and jaws
and of a band around them follow from sums over the silhouettes of three bodies, one of which is wider by the band.
Image gradients along the outline are summed over the difference of a body that is a little wider and one that is a
little narrower. No colour is assumed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Float32, Float64, Image, Posed
from dvrk_cmaes.instrument import Instrument, Link
from dvrk_cmaes.segment.colours import measure_colours
from dvrk_cmaes.silhouette import Body, PixelSums, Renderer

_BINS: Final = 24
_SCALES: Final = np.array([0.12, 0.12, 0.35, 0.12], np.float32)  # of the features, that differ by one bin or so
_LEARNED: Final = 4000  # pixels from which bins are learned
_BAND: Final = 0.0030  # m, width of the band around the silhouette
_THIN: Final = 0.0004  # m, to either side of the outline, where edges are
_USUAL: Final = 0.05  # of the image's longer side, width of a shaft, below which an instrument is less likely
_WEIGHTS: Final = 2.5, 1.0, 0.25, 0.7, 1.0, 1.5, 1.5, 12.0
"""Of separation from the surroundings (geometric mean of the shaft's and that of wrist and jaws), edges of all and of
wrist and jaws, separation from what is beyond the tip, of wrist and jaws from the shaft, share of the shaft's width at
the picture's border, logarithm of a width below the usual one, and of the share of what differs from a known background
that a silhouette covers, less what else it covers."""
_CLEAR: Final = 2.0  # mean edge, from which on a sharper one is no surer: blur differs between cameras
_UNLIKE: Final = 0.3  # separation of wrist and jaws from the shaft, from which on more says nothing
_BEYOND: Final = 0.008  # m along the shaft, by which the instrument is moved to see what is beyond its tip
_THICK: Final = 1.5  # px from the rim of what differs from a background, beyond which pixels count less
_SMOOTHING: Final = 2.0  # pixels added to the bins of each histogram, as the whole picture has them
_SHAFT: Final = 0, 1  # the root link among all links
_LEAST: Final = 1.5, 0.8, 6.0, 4.0
"""Pixels whose histograms count fully, of the shaft and of wrist and jaws, in squared widths of the shaft; and pixels
along the outline of all and of wrist and jaws, whose edges count fully, in widths."""


class Scores(NamedTuple):
    """Measures of C candidates.

    total : the sum that ranks candidates, (C,). measures : those by which a candidate is believed, (C, 4): separation
    of the shaft, and of wrist and jaws, from the band around it, 0 to 1; mean edge along the outline; and separation of
    wrist and jaws from what is beyond their tip.
    """

    total: Float64
    measures: Float64


class Appearance:
    """Likelihood of candidate poses of an instrument, at a reduced size."""

    def __init__(
        self, image: Image, camera: Camera, body: Body, outside: Bool, foreground: Float32 | None = None
    ) -> None:
        """Sort the pixels of an image (H, W, 3) uint8 BGR; ``outside`` (H, W) do not count.

        ``foreground`` (H, W) are log-odds of instrument by a known background.
        """
        counts = ~outside
        assert body.instrument.shaft is not None
        self._radius, self._focal = body.instrument.shaft.radius, float(np.sqrt(camera.fx * camera.fy))
        self.labels = bins_of_image(image)
        channels = np.zeros((_BINS, *counts.shape), np.float32)
        np.put_along_axis(channels, self.labels[None], counts[None].astype(np.float32), axis=0)
        edges = edge_scores(image, counts)
        within = cv2.erode(counts.astype(np.uint8), np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT, borderValue=0)
        before = np.zeros(counts.shape, np.float32)
        if foreground is not None:
            # thin parts locate wrist and jaws; the inside of the shaft is large and locates nothing
            inside = cv2.distanceTransform((foreground > 0).astype(np.uint8), cv2.DIST_L2, 3)
            before = np.where(counts, foreground / np.maximum(inside / _THICK, 1), 0).astype(np.float32)
        self._before = 1 / max(float(np.maximum(before, 0).sum()), 1.0)
        self._bins = PixelSums.of(np.concatenate([channels, (counts & (within == 0))[None], before[None]]))
        self._edges = PixelSums.of(np.stack([edges, counts.astype(np.float32)]))
        self._whole = channels.sum(axis=(1, 2)) / max(float(counts.sum()), 1.0)
        self._longer = max(counts.shape)
        drawn = [Renderer(each, camera, threads=1) for each in _bodies(body)]
        self._wide, self._all, *self._bounds = drawn
        self._distal = 1, len(body.instrument.links)

    def scores(self, at: Posed) -> Scores:
        """Measure C candidates."""
        drawn, of_root = self._all.sums(at.pose, at.joints, self._bins, to_pixel=True, part=_SHAFT)
        whole, at_border, before, shaft = drawn[:, :-2], drawn[:, -2], drawn[:, -1], of_root[:, :-2]
        wide, wide_shaft = self._wide.sums(at.pose, at.joints, self._bins, to_pixel=True, part=_SHAFT)[:, :, :-2]
        distal = np.maximum(whole - shaft, 0)
        around_shaft = np.maximum(wide_shaft - shaft - distal, 0)
        around_distal = np.maximum(wide - wide_shaft - distal, 0)
        moved = at.pose.copy()
        moved[:, :3, 3] += _BEYOND * moved[:, :3, 2]
        beyond = np.maximum(self._all.sums(moved, at.joints, self._bins, to_pixel=True)[:, :-2] - whole, 0)
        beyond_edge, within_edge = (
            each.sums(at.pose, at.joints, self._edges, part=self._distal) for each in self._bounds
        )
        of_edge, of_distal_edge = beyond_edge - within_edge
        width = 2 * self._radius * self._focal / np.maximum(at.pose[:, 2, 3], 1e-3)
        few = _LEAST[1] * width**2
        of_shaft = self._separation(shaft, around_shaft, _LEAST[0] * width**2)
        of_distal = self._separation(distal, around_distal, np.minimum(few, around_distal.sum(axis=1)))
        edges = _mean(of_edge, _LEAST[2] * width)
        ending = self._separation(distal, beyond, np.minimum(few, beyond.sum(axis=1)))
        parts = (
            np.sqrt(of_shaft * of_distal),
            edges,
            _mean(of_distal_edge, _LEAST[3] * width),
            ending,
            np.minimum(self._separation(distal, shaft, few) / _UNLIKE, 1),
            np.minimum(at_border / np.maximum(width, 1), 1),
            -np.maximum(np.log(_USUAL * self._longer / width), 0),
            before * self._before,
        )
        total = sum(weight * part for weight, part in zip(_WEIGHTS, parts, strict=True))
        return Scores(np.asarray(total), np.stack([of_shaft, of_distal, np.minimum(edges, _CLEAR), ending], axis=1))

    def _separation(self, inside: Float64, band: Float64, least: Float64) -> Float64:
        """Return the Jensen-Shannon divergence (C,), 0 to 1, of histograms (C, K), less for few pixels."""
        full = np.maximum(least, 1)
        a, b = (_smoothed(each, self._whole) for each in (inside, band))
        middle = (a + b) / 2
        divergence = 0.5 * ((a * np.log2(a / middle)).sum(axis=1) + (b * np.log2(b / middle)).sum(axis=1))
        return np.asarray(
            divergence * np.minimum(inside.sum(axis=1) / full, 1) * np.minimum(band.sum(axis=1) / full, 1)
        )


def _mean(sums: Float64, least: Float64) -> Float64:
    """Return means (C,) of sums and counts (C, 2), less where the count is below ``least`` (C,), within -1 and 3."""
    return np.asarray(np.clip(sums[:, 0] / np.maximum(sums[:, 1], least), -1, 3))


def _smoothed(counts: Float64, whole: Float64) -> Float64:
    total = counts + _SMOOTHING * (whole + 1 / len(whole))
    return np.asarray(total / total.sum(axis=1, keepdims=True))


def bins_of_image(image: Image) -> NDArray[np.int64]:
    """Sort the pixels of an image into bins by colour and texture, (H, W), from 0 on."""
    features = measure_colours(image).features
    brightness = np.log(image.mean(axis=2) + 8.0).astype(np.float32)
    mean = cv2.blur(brightness, (5, 5))
    texture = np.sqrt(np.maximum(cv2.blur(brightness**2, (5, 5)) - mean**2, 0))
    pixels = np.concatenate([features, texture[..., None]], axis=-1).reshape(-1, 4) / _SCALES
    sample = pixels[:: max(len(pixels) // _LEARNED, 1)]
    order = (sample[:, 2] + sample[:, 1] - sample[:, 0]).argsort(kind="stable").argsort()
    labels = (order * _BINS // len(sample)).astype(np.int32)[:, None]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 1e-3)
    centres = cv2.kmeans(sample, _BINS, labels, criteria, 1, cv2.KMEANS_USE_INITIAL_LABELS)[2]
    nearest = (pixels @ centres.T - (centres**2).sum(axis=1) / 2).argmax(axis=1)
    return np.asarray(nearest.reshape(image.shape[:2]))


def edge_scores(image: Image, counts: Bool) -> Float32:
    """Return of each pixel (H, W) how rare its gradient is: -log of the share with a larger one, less 1; at most 4."""
    smooth = cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.float32)
    smooth = np.log(smooth + 12.0)
    steep = np.max(
        [np.hypot(cv2.Sobel(part, cv2.CV_32F, 1, 0), cv2.Sobel(part, cv2.CV_32F, 0, 1)) for part in cv2.split(smooth)],
        axis=0,
    )
    levels = np.sort(steep[counts])
    if not len(levels):
        return np.zeros(counts.shape, np.float32)
    larger = 1 - np.searchsorted(levels, steep) / len(levels)
    return np.where(counts, np.minimum(-np.log(np.maximum(larger, 1e-4)), 5.0) - 1, 0).astype(np.float32)


@lru_cache(maxsize=8)
def _bodies(body: Body) -> list[Body]:
    """Return a body that is wider by the band, as it is, a little wider and a little narrower."""
    return [Body(_widened(body.instrument, by)) for by in (_BAND, 0.0, _THIN, -_THIN)]


def _widened(instrument: Instrument, by: float) -> Instrument:
    """Return an instrument whose surfaces are moved outwards, m."""
    return replace(instrument, links=tuple(_moved(link, by) for link in instrument.links))


def _moved(link: Link, by: float) -> Link:
    vertices, faces = link.vertices, link.faces
    normals = np.zeros_like(vertices)
    corners = vertices[faces]
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for k in range(3):
        np.add.at(normals, faces[:, k], of_faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return replace(link, vertices=vertices + by * normals)
