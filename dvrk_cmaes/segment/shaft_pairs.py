"""Pairs of straight edges in an image that may bound the shaft of an instrument.

Line segments of the image are joined to longer lines, and two lines make a pair if a cylinder of the shaft's radius
between them would lie at a plausible distance from the camera. The pair yields the cylinder's axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera, View
from dvrk_cmaes.evidence.shaft_edges import find_contour, find_shaft_edges, shaft_axis
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import Bool, Float64, Image, apply, inverse
from dvrk_cmaes.segment.regions import distance_to
from dvrk_cmaes.segment.segmentation import Hints
from dvrk_cmaes.silhouette import Body

_SCALES: Final = 1.0, 0.5  # of the image, at which segments are found
_SHORTEST: Final = 0.025  # of the longer side, of a segment
_SEGMENTS: Final = 220  # longest ones that are used
_LINES: Final = 70  # with the longest segments on them
_OF_LINE: Final = 5  # pairs of a line, at most: a long edge of something else would be in most pairs
_ALIGNED: Final = np.cos(np.deg2rad(3.0))  # of segments on one line
_NEAR: Final = 0.006  # of the longer side, from a line to the ends of segments on it
_PARALLEL: Final = np.cos(np.deg2rad(17.0))  # of the two lines of a pair
_DEPTHS: Final = 0.035, 0.45  # m, of the axis
_NEAREST, _FARTHEST = 0.015, 0.5  # m, between which the instrument is looked for along it
_NARROWEST: Final = 4.0  # px, width of a shaft
_LEAST_OVERLAP: Final = 0.7  # of the width, of the stretch that has both lines
_TRIED: Final = 50  # points along an axis, of which the one deepest in a mask is taken
_AT_EDGE: Final = 3.0  # px from what is outside the picture, whose own edge is no shaft's


@dataclass(frozen=True, eq=False)
class Pair:
    """Two lines that may be the edges of a shaft.

    direction, point : the axis in the camera, (3,), m; the direction has either sign.
    begin, end : coordinates along the direction from the point, m, of the stretch in the picture.
    support : px, length of the segments on both lines where they lie side by side.
    """

    direction: Float64
    point: Float64
    begin: float
    end: float
    support: float


def find_pairs(image: Image, camera: Camera, radius: float, outside: Bool, most: int) -> list[Pair]:
    """Find pairs of lines in an image (H, W) uint8, of the camera's size, best supported first.

    ``radius``, m, is that of the shaft; ``outside`` (H, W) are pixels outside the picture.
    """
    segments = _segments(image, outside)
    if len(segments) < 2:
        return []
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    segments = camera.normalise(segments) * focal + centre
    lines = _joined(segments, _NEAR * max(image.shape))
    limits = np.array([camera.width - 1, camera.height - 1])
    along = np.array([line.direction for line in lines])
    parallel = np.argwhere(np.tril(np.abs(along @ along.T) >= _PARALLEL, -1)).tolist()
    found = [(_sides(lines[i], lines[j], camera, radius), [i, j]) for i, j in parallel]
    beside = [(sides, of) for sides, of in found if sides is not None]
    beside.sort(key=lambda each: -each[0].support)
    kept: list[Pair] = []
    uses = np.zeros(len(lines), np.intp)
    for sides, of in beside:
        if len(kept) == most:
            break
        if uses[of].max() < _OF_LINE and (pair := _pair(sides, camera, radius, limits)) is not None:
            kept.append(pair)
            uses[of] += 1
    return kept


def pair_of_mask(mask: Bool, camera: Camera, radius: float) -> Pair | None:
    """Return the two straight sides of a mask (H, W), of the camera's size, if they may bound a shaft; or else None."""
    edges = find_shaft_edges(mask, find_contour(mask, camera), camera, radius)
    if isinstance(edges, str):
        return None
    lines = []
    for first, last in edges[0].ends:
        length = float(np.linalg.norm(last - first))
        stretch = np.array([[-length / 2, length / 2]])
        lines.append(_Line((last - first) / max(length, 1e-9), (first + last) / 2, stretch))
    sides = _sides(lines[0], lines[1], camera, radius)
    return None if sides is None else _pair(sides, camera, radius, np.array([camera.width - 1, camera.height - 1]))


def prompts_in(other: View, first: SeenView, prompts: Hints, body: Body, *, several: bool = False) -> Hints:
    """Return the prompts of a further view, given those of the first one, which are pixels of that.

    A point on the instrument that the prompts choose in the first view, or that is taken there of ``several``. Its
    distance follows from the width between the shaft's edges; there is none where the first view does not show these.
    """
    shaft, mask = body.instrument.shaft, first.mask
    if shaft is None or not (several or prompts != Hints()) or not mask.any() or mask.all():
        return Hints()
    pair = pair_of_mask(mask, first.camera, shaft.radius)
    if pair is None:
        return Hints()
    axis = pair.point + np.linspace(pair.begin, pair.end, _TRIED)[:, None] * pair.direction
    u, v = np.clip(np.rint(first.camera.project(axis)).astype(int), 0, np.array(mask.shape[::-1]) - 1).T
    seen = apply(other.view_from_camera @ inverse(first.view_from_camera), axis)
    pixels = other.camera.project(seen)
    within = (seen[:, 2] > 0) & ((pixels >= 0) & (pixels < (other.camera.width, other.camera.height))).all(axis=1)
    depths = np.where(within, distance_to(~mask)[v, u], 0)
    deepest = int(depths.argmax())
    return Hints(points=((float(pixels[deepest, 0]), float(pixels[deepest, 1])),)) if depths[deepest] > 0 else Hints()


def _segments(image: Image, outside: Bool) -> Float64:
    """Return the longest line segments (N, 2, 2), px, without those along the edge of the picture."""
    found = []
    for scale in _SCALES:
        small = image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        lines = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(small)[0]
        if lines is not None:
            found.append((lines.reshape(-1, 2, 2).astype(np.float64) + 0.5) / scale - 0.5)
    if not found:
        return np.zeros((0, 2, 2))
    segments = np.concatenate(found)
    length = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    inside = cv2.distanceTransform(np.pad(~outside, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    middle = np.clip(np.rint(segments.mean(axis=1)).astype(int), 0, [image.shape[1] - 1, image.shape[0] - 1])
    kept = (length > _SHORTEST * max(image.shape)) & (inside[middle[:, 1], middle[:, 0]] > _AT_EDGE)
    order = np.argsort(-length[kept], kind="stable")[:_SEGMENTS]
    return np.asarray(segments[kept][order])


@dataclass(frozen=True, eq=False)
class _Line:
    """A line: unit direction (2,), a point (2,), and the stretches (M, 2) along it that have segments, px."""

    direction: Float64
    point: Float64
    stretches: Float64

    @property
    def length(self) -> float:
        return float((self.stretches[:, 1] - self.stretches[:, 0]).sum())

    def along(self, direction: Float64, stretches: Float64) -> Float64:
        """Return the coordinates along a direction (2,), px, of the beginnings and ends (..., 2) of its stretches."""
        return np.sort(stretches * (self.direction @ direction) + self.point @ direction, axis=-1)


def _joined(segments: Float64, near: float) -> list[_Line]:
    """Join segments (N, 2, 2) to lines, longest first; each is on the line that begins with the longest of them."""
    delta = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(delta, axis=1)
    direction = delta / length[:, None]
    free = np.ones(len(segments), np.bool_)
    lines = []
    for k in range(len(segments)):
        if not free[k]:
            continue
        along, point = direction[k], segments[k].mean(axis=0)
        for _ in range(2):
            normal = np.array([-along[1], along[0]])
            away = np.abs((segments - point) @ normal).max(axis=1)
            on = (np.abs(direction @ along) > _ALIGNED) & (away < near)
            on[k] = True
            ends = segments[on].reshape(-1, 2)
            weight = np.repeat(length[on], 2)
            point = weight @ ends / weight.sum()
            scatter = ((ends - point) * weight[:, None]).T @ (ends - point)
            turned = np.linalg.eigh(scatter)[1][:, 1]
            along = turned * np.sign(turned @ along)
        free &= ~on
        places = np.sort((segments[on] - point) @ along, axis=1)
        lines.append(_Line(along, point, _united(places)))
    lines.sort(key=lambda line: -line.length)
    return lines[:_LINES]


def _united(stretches: Float64) -> Float64:
    """Return the union of stretches (N, 2) as ones that do not overlap."""
    united: list[list[float]] = []
    for begin, end in sorted(stretches.tolist()):
        if united and begin <= united[-1][1]:
            united[-1][1] = max(united[-1][1], end)
        else:
            united.append([begin, end])
    return np.array(united)


@dataclass(frozen=True, eq=False)
class _Sides:
    """Two lines beside each other: the one in the direction of the normal, the other, and the direction (2,) of both.

    middle : coordinate along, px, of the middle of the stretch that has both. support : as of `Pair`.
    """

    upper: _Line
    lower: _Line
    along: Float64
    middle: float
    support: float

    @property
    def normal(self) -> Float64:
        return np.array([-self.along[1], self.along[0]])

    def across(self, line: _Line) -> float:
        """Return the coordinate of a line across the direction at the middle, px."""
        step = (self.middle - line.point @ self.along) / (line.direction @ self.along)
        return float((line.point + step * line.direction) @ self.normal)


def _sides(first: _Line, second: _Line, camera: Camera, radius: float) -> _Sides | None:
    """Return two lines that lie beside each other as a shaft's sides may, or None."""
    cosine = float(first.direction @ second.direction)
    if abs(cosine) < _PARALLEL:
        return None
    along = first.direction + np.sign(cosine) * second.direction
    along /= np.linalg.norm(along)
    one, other = (line.along(along, line.stretches[[0, -1], [0, 1]]) for line in (first, second))
    low, high = max(one[0], other[0]), min(one[1], other[1])
    sides = _Sides(first, second, along, (low + high) / 2, 0.0)
    width = sides.across(first) - sides.across(second)
    focal = float(np.sqrt(camera.fx * camera.fy))
    widest, narrowest = (2 * radius * focal / depth for depth in _DEPTHS)
    if not max(narrowest, _NARROWEST) < abs(width) < widest or high - low < _LEAST_OVERLAP * abs(width):
        return None
    one, other = first.along(along, first.stretches), second.along(along, second.stretches)
    begin, end = np.maximum(one[:, None, 0], other[:, 0]), np.minimum(one[:, None, 1], other[:, 1])
    support = float(np.maximum(end - begin, 0).sum()) + 0.25 * (high - low)
    upper, lower = (first, second) if width > 0 else (second, first)
    return replace(sides, upper=upper, lower=lower, support=support)


def _pair(sides: _Sides, camera: Camera, radius: float, limits: Float64) -> Pair | None:
    """Return two sides as a pair, or None if they cannot bound a shaft."""
    along, normal, planes = sides.along, sides.normal, []
    for line, sign in ((sides.upper, 1.0), (sides.lower, -1.0)):
        outward = np.array([-line.direction[1], line.direction[0]])
        outward *= np.sign(outward @ normal) * sign
        planes.append(np.array([*outward, -outward @ line.point]) @ camera.matrix)
    direction, point = shaft_axis(np.stack(planes) / np.linalg.norm(planes, axis=1, keepdims=True), radius)
    if abs(direction[2]) > np.cos(np.deg2rad(4.0)):
        return None
    # the stretch within the picture and before the camera: beyond its vanishing point an axis is behind it
    corners = np.array([[0, 0], [limits[0], 0], [0, limits[1]], limits]) @ along
    steps = np.append(np.linspace(corners.min(), corners.max(), 200), sides.middle)
    pixels = (sides.across(sides.upper) + sides.across(sides.lower)) / 2 * normal + steps[:, None] * along
    # coordinates, m, on the axis of its points nearest to the rays of these pixels
    rays = np.column_stack([(pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy), np.ones(len(pixels))])
    away = np.cross(rays, np.cross(direction, rays))
    seen = -(away @ point) / (away @ direction)
    depths = point[2] + seen * direction[2]
    if not _DEPTHS[0] < depths[-1] < _DEPTHS[1]:
        return None
    kept = seen[((pixels >= 0) & (pixels <= limits)).all(axis=1) & (depths > _NEAREST) & (depths < _FARTHEST)]
    return Pair(direction, point, float(kept.min()), float(kept.max()), sides.support) if len(kept) > 1 else None
