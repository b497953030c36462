"""Detection of the shaft's two straight edges in a mask, and the shaft's axis in space from edges and radius.

Oriented contour points vote for lines, and lines are accepted only in pairs that could bound a cylinder. A bent wrist,
an isolated region or an interrupted edge is therefore not mistaken for the shaft, as it may be with the two longest
Hough lines of a Canny image. Lines are stored in undistorted normalised coordinates: A X + B Y + C = 0, where (A, B, C)
has unit length and points out of the shaft. This vector is also the normal of the plane through the camera centre that
touches the shaft along the edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.quantiles import NORMAL_MEDIAN
from dvrk_cmaes.geometry import Float64, cross

_HALF = 0.5  # share of a pixel that is instrument, from which on it is
_BLUR = 1.5  # px, standard deviation of the blur before the contour is located between pixels
_NORMAL_BLUR = 3.0  # px, of the additional blur before the normals are computed
_AROUND = 24  # px around the mask, beyond which neither blur reaches
_TOGETHER = 16  # pixels of a row that OpenCV filters at once; it rounds the rest of a row otherwise
_LEAST_CHAIN = 20  # points of a contour
_BORDER = 3.0  # px; contour nearer to the image border is left out
_NEAR_LINE = 1.2  # px, standard deviation of contour points about an edge during the search for lines
_FACING = 0.93  # least cosine between an edge's normal and that of a contour point on it
_LARGEST_GAP = 40.0  # px without contour points along an edge
_LEAST_POINTS = 12  # contour points of an edge
_AT_BORDER = 25.0  # px from the image border, for an edge that ends there
_HYPOTHESES = 450  # lines through two contour points
_VOTERS = 400  # contour points that define lines and vote for them, about
_KEPT_LINES = 28  # distinct lines with the most votes
_LEAST_LENGTH = 0.7  # of an edge, in widths of the shaft
_DISTINCT = 0.18  # largest distance between the ends of pairs that are the same, in widths of the shaft
_WIDEST = 2.5
"""Largest half width of a mask at its widest place, as a multiple of that between the shaft's edges.

In 287 frames of 104 worlds it was 0.66 to 1.74 of right pairs and 0.63 to 2.12, or 3.2 to 8.9, of wrong ones.
"""
_USUAL_WIDTH, _USUAL_HALF_WIDTH = 640, 20.0
"""Width of the images, px, and half that of a mask at its widest place, for which the limits in pixels are stated."""
_OPPOSITE = -np.cos(np.deg2rad(35.0))  # largest cosine between the normals of the two edges in the image
_DEPTHS = (0.02, 0.5)  # m, least and largest depth of the middle of the visible shaft


@dataclass(frozen=True, eq=False)
class Contour:
    """Outer contour points of a mask.

    ``pixels`` (N, 2) are subpixel positions where the blurred mask equals one half. ``ideal`` (N, 2) are the same
    points without lens distortion, in pixels of a pinhole camera with the same matrix; ``normals`` (N, 2) are unit
    vectors that point out of the mask in this undistorted image. Points near the image border or an ignored region are
    left out.
    """

    pixels: Float64
    ideal: Float64
    normals: Float64


@dataclass(frozen=True, eq=False)
class ShaftEdges:
    """The shaft's two edges in a mask.

    ``planes`` (2, 3): homogeneous lines in normalised coordinates, unit vectors pointing out of the shaft.
    ``ends`` (2, 2, 2): the first and last point on each edge, undistorted pixels.
    ``sigma`` (2,): standard deviation of the contour about each edge, px.
    ``support`` (2,): number of contour points on each edge.
    """

    planes: Float64
    ends: Float64
    sigma: Float64
    support: NDArray[np.int64]


def find_contour(mask: NDArray[np.bool_], camera: Camera, ignore: NDArray[np.bool_] | None = None) -> Contour:
    """Find the outer contours of a mask (H, W) with subpixel accuracy, without the parts along the image border."""
    height, width = mask.shape
    pixels = np.ascontiguousarray(mask).view(np.uint8)
    found, _ = cv2.findContours(pixels, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    chains = [chain[:, 0, :] for chain in found if len(chain) >= _LEAST_CHAIN]
    points = np.concatenate(chains).astype(np.float64) if chains else np.zeros((0, 2))
    column, row = points[:, 0].astype(int), points[:, 1].astype(int)
    left, top, wide, high = cv2.boundingRect(pixels)
    # beyond, the blurred mask is zero
    low = np.maximum([left - _AROUND, top - _AROUND], 0) // _TOGETHER * _TOGETHER
    right = -(-(left + wide + _AROUND) // _TOGETHER) * _TOGETHER
    window = np.s_[low[1] : top + high + _AROUND, low[0] : right]
    # Replicated borders, because the instrument continues outside the image.
    blurred = cv2.GaussianBlur(mask[window].astype(np.float32), (0, 0), _BLUR, borderType=cv2.BORDER_REPLICATE)
    softer = cv2.GaussianBlur(blurred, (0, 0), _NORMAL_BLUR, borderType=cv2.BORDER_REPLICATE)
    at = np.column_stack([column - low[0], row - low[1]])
    (gx, gy), (nx, ny) = (_kernel.sobel_at(np.asarray(image, np.float32), at).T for image in (blurred, softer))
    grey = blurred[at[:, 1], at[:, 0]]
    steep = np.hypot(gx, gy)
    keep = steep > 0.02
    inside = (points >= _BORDER).all(axis=1) & (points <= [width - 1 - _BORDER, height - 1 - _BORDER]).all(axis=1)
    keep &= inside
    if ignore is not None:
        near_ignored = cv2.dilate(ignore.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
        keep &= ~near_ignored[row, column]
    points, gx, gy, nx, ny, steep, grey = (a[keep] for a in (points, gx, gy, nx, ny, steep, grey))
    step = np.clip((grey - 0.5) / steep, -1.5, 1.5)
    pixels = points - (step / steep)[:, None] * np.stack([gx, gy], axis=1)
    normal = -np.stack([nx, ny], axis=1) / np.maximum(np.hypot(nx, ny), 1e-9)[:, None]
    if camera.is_pinhole:
        return Contour(pixels, pixels, normal)
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    xy = camera.normalise(pixels)
    across = camera.project_along(np.c_[xy, np.ones(len(xy))], normal)[1][:, :2] / focal  # towards the normal's side
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    return Contour(pixels, xy * focal + centre, across)


def _votes(contour: Contour, line: Float64, index: NDArray[np.intp]) -> float:
    """Compute the support of a line by contour points: the sum of their weights, 1 for a point on the line."""
    return float(np.exp(-0.5 * ((contour.ideal[index] @ line[:2] + line[2]) / _NEAR_LINE) ** 2).sum())


def _candidate_lines(contour: Contour, rng: np.random.Generator) -> Float64:
    """Find distinct lines (n, 3) through pairs of contour points with matching normals, best supported first."""
    every = max(1, len(contour.ideal) // _VOTERS)
    points, normals = (np.ascontiguousarray(part[::every]) for part in (contour.ideal, contour.normals))
    count = len(points)
    first = rng.integers(count, size=_HYPOTHESES * 4)
    second = rng.integers(count, size=_HYPOTHESES * 4)
    delta = points[second] - points[first]
    length = np.linalg.norm(delta, axis=1)
    normal = np.stack([-delta[:, 1], delta[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    normal *= np.sign((normal * normals[first]).sum(axis=1))[:, None]
    agree = np.minimum((normal * normals[first]).sum(axis=1), (normal * normals[second]).sum(axis=1))
    good = np.flatnonzero((length > 15) & (agree > _FACING))[:_HYPOTHESES]
    lines = np.c_[normal[good], -(normal[good] * points[first[good]]).sum(axis=1)]
    support, middle = _kernel.line_support(points, normals, lines, _NEAR_LINE, _FACING)
    kept: list[int] = []
    left = np.argsort(-support, kind="stable")
    while len(left) and len(kept) < _KEPT_LINES:
        best = lines[left[0]]
        kept.append(int(left[0]))
        same = (lines[left, :2] @ best[:2] > 0.9985) & (np.abs(middle[left] @ best[:2] + best[2]) < 3)
        same[0] = True
        left = left[~same]
    return np.asarray(lines[kept])


def _to_planes(lines: Float64, camera: Camera) -> Float64:
    """Convert lines (n, 3) in undistorted pixels to unit plane normals (n, 3) in normalised coordinates."""
    planes = lines @ camera.matrix
    return np.asarray(planes / np.linalg.norm(planes, axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class _Edge:
    """A straight piece of the contour.

    ``line`` (3,) in undistorted pixels; ``index`` (N,) of its contour points; ``sigma``, px, their standard deviation;
    ``ends`` (2, 2), undistorted pixels; ``votes``, the support of the line.
    """

    line: Float64
    index: NDArray[np.intp]
    sigma: float
    ends: Float64
    votes: float

    @staticmethod
    def fitted(contour: Contour, lines: Float64) -> list[_Edge]:
        """Fit lines to the contour near first guesses (n, 3), and leave out those with too few contour points."""
        found = _kernel.fit_lines(
            contour.ideal,
            contour.normals,
            lines,
            sigma=_NEAR_LINE,
            near=2.5,
            facing=_FACING,
            gap=_LARGEST_GAP,
            least_sigma=0.3,
            reach=3.0,
            least_reach=1.5,
            normal_median=NORMAL_MEDIAN,
            iterations=3,
            least=_LEAST_POINTS,
        )
        return [_Edge._of(contour, *one) for one in found if len(one[1]) >= _LEAST_POINTS]

    @staticmethod
    def _of(contour: Contour, line: Float64, index: NDArray[np.int64], sigma: float) -> _Edge:
        outermost = contour.ideal[index[[0, -1]]]
        ends = outermost - (outermost @ line[:2] + line[2])[:, None] * line[:2]
        return _Edge(line, index, sigma, ends, _votes(contour, line, index))


def half_width(mask: NDArray[np.bool_]) -> float:
    """Return half the width, px, of a mask (H, W) at its widest place."""
    pixels = np.ascontiguousarray(mask).view(np.uint8)
    left, top, wide, high = cv2.boundingRect(pixels)
    window = pixels[max(top - 1, 0) : top + high + 1, max(left - 1, 0) : left + wide + 1]
    return float(cv2.distanceTransform(window, cv2.DIST_L2, 3).max())


def find_shaft_edges(
    mask: NDArray[np.bool_],
    contour: Contour,
    camera: Camera,
    radius: float,
    *,
    ignore: NDArray[np.bool_] | None = None,
    seed: int = 0,
    most: int = 3,
    widest: float | None = None,
) -> tuple[ShaftEdges, ...] | str:
    """Find the shaft's two edges in a mask; returns the reason, in words, if they cannot be found.

    Candidates are pairs of straight pieces of the contour whose normals point away from each other, with mask between
    them, that would bound a cylinder of ``radius`` (m) at a plausible depth for an endoscope. Returns up to ``most``
    pairs, best supported first; each differs from every better one in at least one edge. A wide shaft in a large image
    is looked for in a smaller one, as its edges are rougher by as much. ``widest`` is `half_width` of the mask, if that
    is known.
    """
    widest = half_width(mask) if widest is None else widest
    by = min(round(camera.width / _USUAL_WIDTH), int(widest / _USUAL_HALF_WIDTH))
    if by < 2:
        return _find_edges(mask, contour, camera, radius, widest, seed, most)
    small = camera.scaled(camera.width // by, camera.height // by)
    size = small.width, small.height
    pixels = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > _HALF
    hidden = None
    if ignore is not None:
        hidden = cv2.resize(ignore.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
    found = _find_edges(pixels, find_contour(pixels, small, hidden), small, radius, widest / by, seed, most)
    if isinstance(found, str):
        return found
    scale = np.array([camera.width / small.width, camera.height / small.height])
    return tuple(
        replace(pair, ends=(pair.ends + 0.5) * scale - 0.5, sigma=pair.sigma * by, support=pair.support * by)
        for pair in found
    )


def _find_edges(
    mask: NDArray[np.bool_], contour: Contour, camera: Camera, radius: float, widest: float, seed: int, most: int
) -> tuple[ShaftEdges, ...] | str:
    """Find the shaft's edges as `find_shaft_edges`; ``widest`` is the half width, px, of the mask."""
    if len(contour.ideal) < 40:
        return "the mask has too little contour inside the image"
    rng = np.random.default_rng(seed)
    edges = sorted(_Edge.fitted(contour, _candidate_lines(contour, rng)), key=lambda edge: -edge.votes)
    chosen: list[ShaftEdges] = []
    best = 0.0
    for support, width, first, second in _pairs(edges, mask.shape, 2 * widest / _WIDEST):
        if support <= 0.4 * best or support <= 0 or len(chosen) == most:
            break
        ends = np.stack([first.ends, second.ends])
        if any(np.abs(ends - other.ends).max() < _DISTINCT * width for other in chosen):
            continue
        if not _bounds_cylinder(mask, camera, radius, first, second):
            continue
        best = max(best, support)
        chosen.append(
            ShaftEdges(
                planes=_to_planes(np.stack([first.line, second.line]), camera),
                ends=ends,
                sigma=np.array([first.sigma, second.sigma]),
                support=np.array([len(first.index), len(second.index)]),
            )
        )
    return tuple(chosen) if chosen else "no two straight stretches of the contour could bound the shaft"


def _pairs(edges: Sequence[_Edge], shape: tuple[int, ...], narrowest: float) -> list[tuple[float, float, _Edge, _Edge]]:
    """Return the pairs of edges that may be the shaft's, with support and width, px, the best first.

    The support is 0 of edges that are not side by side, or are closer than ``narrowest``, px.
    """
    if len(edges) < 2:
        return []
    lines, ends = np.stack([edge.line for edge in edges]), np.stack([edge.ends for edge in edges])
    votes = np.array([edge.votes for edge in edges])
    second, first = np.nonzero(np.tri(len(edges), k=-1, dtype=np.bool_) & (lines[:, :2] @ lines[:, :2].T < _OPPOSITE))
    one, other = lines[first], lines[second]
    direction = np.stack([-one[:, 1], one[:, 0]], axis=1)
    a = np.einsum("ned,nd->ne", ends[first], direction)
    b = np.einsum("ned,nd->ne", ends[second], direction)[:, ::-1]  # the edges run in opposite directions
    overlap = np.minimum(a[:, 1], b[:, 1]) - np.maximum(a[:, 0], b[:, 0])
    middle = (ends[first].sum(axis=1) + ends[second].sum(axis=1)) / 4
    width = -(((one + other)[:, :2] * middle).sum(axis=1) + one[:, 2] + other[:, 2])
    shorter_edge = np.minimum(a[:, 1] - a[:, 0], b[:, 1] - b[:, 0])
    beside = (width >= max(6.0, narrowest)) & (overlap >= -0.5 * width) & (shorter_edge >= _LEAST_LENGTH * width)
    # The shaft enters at the image border, so edges that end there have a larger weight.
    limit = np.array([shape[1] - 1, shape[0] - 1])
    at_border = np.minimum(ends, limit - ends).min(axis=(1, 2)) < _AT_BORDER
    shorter, longer = np.sort([votes[first], votes[second]], axis=0)
    weight = 1.0 + 0.5 * at_border[first] + 0.5 * at_border[second]
    support = np.where(beside, weight * (2 * shorter + 0.5 * (longer - shorter)), 0.0)
    order = np.argsort(-support, kind="stable")
    return [(float(support[k]), float(width[k]), edges[first[k]], edges[second[k]]) for k in order]


def _bounds_cylinder(mask: NDArray[np.bool_], camera: Camera, radius: float, first: _Edge, second: _Edge) -> bool:
    """Return whether a cylinder between two edges has a plausible depth, and the mask fills the area between them."""
    ends = np.stack([first.ends, second.ends[::-1]])
    middle = ends.mean(axis=(0, 1))
    direction, point = shaft_axis(_to_planes(np.stack([first.line, second.line]), camera), radius)
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    ray = np.array([*((middle - centre) / focal), 1.0])
    normal = cross(direction, cross(ray, direction))
    depth = float(normal @ point / (normal @ ray))  # of the axis where it passes the middle of the edges
    if not _DEPTHS[0] < depth < _DEPTHS[1]:
        return False
    s, t = (g.reshape(-1, 1) for g in np.meshgrid(np.linspace(0.05, 0.95, 10), np.linspace(0.1, 0.9, 5)))
    sides = ends[:, 0, None] + s * (ends[:, 1] - ends[:, 0])[:, None]
    inside = sides[0] + t * (sides[1] - sides[0])
    pixels = np.rint(camera.distort((inside - centre) / focal) * focal + centre).astype(int)
    in_image = (pixels >= 0).all(axis=1) & (pixels < [mask.shape[1], mask.shape[0]]).all(axis=1)
    return bool(in_image.any() and mask[pixels[in_image, 1], pixels[in_image, 0]].mean() >= 0.85)


def shaft_axis(planes: Float64, radius: float) -> tuple[Float64, Float64]:
    """Compute the axis of a cylinder that touches two planes through the camera centre.

    ``planes`` (2, 3) are unit normals pointing out of the cylinder; ``radius`` is in m. Returns the axis's unit
    direction (of either sign) and its point nearest to the camera centre, m, both (3,) in the camera's frame. The
    direction lies in both planes, and the axis is at distance ``radius`` from both, on the inner side.
    """
    across = cross(planes[0], planes[1])
    length = np.linalg.norm(across)
    direction = across / length
    return direction, -radius / length * cross(planes[1] - planes[0], direction)


def axis_tilt_error(edges: ShaftEdges, camera: Camera, radius: float) -> float:
    """Compute the standard deviation, rad, of the direction of the axis that follows from the errors of the edges.

    It is mostly the error of the tilt towards the camera, and large for short edges. The angle of each edge has a
    standard deviation that follows from its ``sigma`` and its length, with one independent point per 8 px of contour.
    The axis is computed again with each edge turned by that angle about its middle, and the changes are added in
    quadrature.
    """
    unturned, _ = shaft_axis(edges.planes, radius)
    total = 0.0
    for i in range(2):
        length = float(np.linalg.norm(edges.ends[i, 1] - edges.ends[i, 0]))
        points = max(float(edges.support[i]) / 8, 2.0)
        turn = max(float(edges.sigma[i]), 0.5) * np.sqrt(12 / points) / max(length, 1.0)
        line = edges.planes[i] @ np.linalg.inv(camera.matrix)
        line = line / np.linalg.norm(line[:2])
        cosine, sine = np.cos(turn), np.sin(turn)
        normal = np.array([cosine * line[0] - sine * line[1], sine * line[0] + cosine * line[1]])
        turned = edges.planes.copy()
        turned[i] = _to_planes(np.array([[*normal, -normal @ edges.ends[i].mean(axis=0)]]), camera)[0]
        total += float(np.arccos(np.clip(abs(shaft_axis(turned, radius)[0] @ unturned), -1, 1))) ** 2
    return float(np.sqrt(total))
