"""The two straight edges of the shaft in a mask, and the axis in space that they and the radius fix.

Sturdier than the two longest Hough lines of a Canny image: oriented contour points vote for lines, and lines are only
taken in pairs that could bound a cylinder, so a bent wrist, a blob or a broken edge does not pass for the shaft. Lines
are kept in normalised coordinates, where no lens bends them: A X + B Y + C = 0, with (A, B, C) of unit length and
pointing out of the shaft; as a vector it is the normal of the plane through the eye that touches the shaft there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera

Float64 = NDArray[np.float64]

_BLUR = 1.5  # px, of the mask before its contour is placed between pixels
_NORMAL_BLUR = 3.0  # px more, before its normals are taken
_BORDER = 3.0  # px beside the image border that say nothing about the instrument
_NEAR_LINE = 1.2  # px, spread of a contour point about an edge while lines are sought
_FACING = 0.93  # cosine between an edge's normal and a contour point's
_LARGEST_GAP = 40.0  # px along an edge
_FEWEST = 12  # contour points of an edge
_AT_BORDER = 25.0  # px
_HYPOTHESES = 450
_VOTERS = 400  # contour points that lines are drawn through and voted for by
_KEPT_LINES = 28
_SHORTEST = 0.7  # of an edge's length, in widths of the shaft
_MOST_APART = np.deg2rad(35.0)  # between the two edges in the image
_DEPTHS = (0.02, 0.5)  # m, from the eye to the middle of the visible shaft


@dataclass(frozen=True, eq=False)
class Contour:
    """Outer contour points of a mask.

    ``pixels`` (N, 2) lie between pixel centres where the blurred mask is one half; ``ideal`` (N, 2) are the same
    without the lens's distortion, in pixels of a pinhole of the same matrix; ``normals`` (N, 2) point out of the mask
    in that ideal image. Points beside the image border or an ignored region are left out.
    """

    pixels: Float64
    ideal: Float64
    normals: Float64


@dataclass(frozen=True, eq=False)
class ShaftEdges:
    """The shaft's two edges in a mask.

    ``planes`` (2, 3): homogeneous lines in normalised coordinates, unit vectors pointing out of the shaft.
    ``ends`` (2, 2, 2): the first and last point on each edge, ideal pixels.
    ``sigma`` (2,): spread of the contour about each edge, px. ``support`` (2,): how many contour points lie on it.
    """

    planes: Float64
    ends: Float64
    sigma: Float64
    support: NDArray[np.int64]


def find_contour(mask: NDArray[np.bool_], camera: Camera, ignore: NDArray[np.bool_] | None = None) -> Contour:
    """Outer contours of a mask (H, W), between pixels, without the stretches along the image border."""
    height, width = mask.shape
    image = mask.astype(np.float32)
    # Replicated borders: the instrument goes on outside the image.
    blurred = cv2.GaussianBlur(image, (0, 0), _BLUR, borderType=cv2.BORDER_REPLICATE)
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    chains = [chain[:, 0, :] for chain in found if len(chain) >= 20]
    points = np.concatenate(chains).astype(np.float64) if chains else np.zeros((0, 2))
    column, row = points[:, 0].astype(int), points[:, 1].astype(int)
    gx = cv2.Sobel(blurred, cv2.CV_32F, 1, 0, scale=0.125)[row, column].astype(np.float64)
    gy = cv2.Sobel(blurred, cv2.CV_32F, 0, 1, scale=0.125)[row, column].astype(np.float64)
    softer = cv2.GaussianBlur(blurred, (0, 0), _NORMAL_BLUR, borderType=cv2.BORDER_REPLICATE)
    nx = cv2.Sobel(softer, cv2.CV_32F, 1, 0)[row, column].astype(np.float64)
    ny = cv2.Sobel(softer, cv2.CV_32F, 0, 1)[row, column].astype(np.float64)
    steep = np.hypot(gx, gy)
    keep = steep > 0.02
    inside = (points >= _BORDER).all(axis=1) & (points <= [width - 1 - _BORDER, height - 1 - _BORDER]).all(axis=1)
    keep &= inside
    if ignore is not None:
        near_ignored = cv2.dilate(ignore.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
        keep &= ~near_ignored[row, column]
    points, gx, gy, nx, ny, steep, row, column = (a[keep] for a in (points, gx, gy, nx, ny, steep, row, column))
    step = np.clip((blurred[row, column] - 0.5) / steep, -1.5, 1.5)
    pixels = points - (step / steep)[:, None] * np.stack([gx, gy], axis=1)
    normal = -np.stack([nx, ny], axis=1) / np.maximum(np.hypot(nx, ny), 1e-9)[:, None]
    if camera.is_pinhole:
        return Contour(pixels, pixels, normal)
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    ideal = camera.normalise(pixels) * focal + centre
    ahead = camera.normalise(pixels + np.stack([-normal[:, 1], normal[:, 0]], axis=1)) * focal + centre
    tangent = ahead - ideal
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    return Contour(pixels, ideal, np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def _votes(contour: Contour, line: Float64, index: NDArray[np.intp]) -> float:
    """How strongly points of the contour support a line: a length in points."""
    return float(np.exp(-0.5 * ((contour.ideal[index] @ line[:2] + line[2]) / _NEAR_LINE) ** 2).sum())


def _candidate_lines(contour: Contour, rng: np.random.Generator) -> Float64:
    """Lines (n, 3) through pairs of contour points that agree with both normals, the best supported ones first."""
    every = max(1, len(contour.ideal) // _VOTERS)
    points, normals = contour.ideal[::every], contour.normals[::every]
    count = len(points)
    first = rng.integers(count, size=_HYPOTHESES * 4)
    second = rng.integers(count, size=_HYPOTHESES * 4)
    way = points[second] - points[first]
    length = np.linalg.norm(way, axis=1)
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    normal *= np.sign((normal * normals[first]).sum(axis=1))[:, None]
    agree = np.minimum((normal * normals[first]).sum(axis=1), (normal * normals[second]).sum(axis=1))
    good = np.flatnonzero((length > 15) & (agree > _FACING))[:_HYPOTHESES]
    lines = np.c_[normal[good], -(normal[good] * points[first[good]]).sum(axis=1)]
    away = points @ lines[:, :2].T + lines[:, 2]
    votes = np.exp(-0.5 * (away / _NEAR_LINE) ** 2)
    votes[normals @ lines[:, :2].T < _FACING] = 0.0
    support = votes.sum(axis=0)
    middle = (votes.T @ points) / np.maximum(support, 1e-9)[:, None]
    kept: list[int] = []
    for i in np.argsort(-support, kind="stable"):
        known = lines[kept]
        same = (known[:, :2] @ lines[i, :2] > 0.9985) & (np.abs(known[:, :2] @ middle[i] + known[:, 2]) < 3)
        if not same.any():
            kept.append(int(i))
        if len(kept) == _KEPT_LINES:
            break
    return np.asarray(lines[kept])


def _on_line(contour: Contour, line: Float64, reach: float) -> NDArray[np.intp]:
    """Contour points on a line, along its longest stretch that has no large gap."""
    near = (np.abs(contour.ideal @ line[:2] + line[2]) < reach) & (contour.normals @ line[:2] > _FACING)
    index = np.flatnonzero(near)
    if len(index) < 2:
        return index
    position = contour.ideal[index] @ np.array([-line[1], line[0]])
    order = np.argsort(position, kind="stable")
    gaps = np.flatnonzero(np.diff(position[order]) > _LARGEST_GAP)
    stretches = np.split(order, gaps + 1)
    return np.asarray(index[max(stretches, key=len)])


def _fit_line(contour: Contour, line: Float64, rounds: int = 3) -> tuple[Float64, NDArray[np.intp], float]:
    """Fit a line robustly to the contour points near it: the line, its points, and their spread in px."""
    index = _on_line(contour, line, 2.5 * _NEAR_LINE)
    sigma = _NEAR_LINE
    for _ in range(rounds):
        points = contour.ideal[index]
        away = points @ line[:2] + line[2]
        weight = np.maximum(1 - (away / (3 * sigma)) ** 2, 0) ** 2  # Tukey
        if len(index) < _FEWEST or weight.sum() < 0.5 * _FEWEST:
            break
        mean = weight @ points / weight.sum()
        centred = points - mean
        scatter = (centred * weight[:, None]).T @ centred
        normal = np.linalg.eigh(scatter)[1][:, 0]
        normal = normal * np.sign(normal @ line[:2])
        line = np.array([*normal, -normal @ mean])
        spread = 1.4826 * float(np.median(np.abs(points @ normal + line[2])))
        sigma = float(np.clip(spread, 0.3, _NEAR_LINE))
        index = _on_line(contour, line, max(3 * sigma, 1.5))
    return line, index, sigma


def _to_planes(lines: Float64, camera: Camera) -> Float64:
    """Lines (n, 3) in ideal pixels as unit plane normals in normalised coordinates."""
    planes = lines @ camera.matrix
    return np.asarray(planes / np.linalg.norm(planes, axis=1, keepdims=True))


@dataclass(frozen=True, eq=False)
class _Edge:
    """A straight stretch of the contour: its line (3,), its contour points, their spread and support, its two ends."""

    line: Float64
    index: NDArray[np.intp]
    sigma: float
    ends: Float64
    votes: float

    @staticmethod
    def fit(contour: Contour, line: Float64) -> _Edge | None:
        """Fit a line to the contour; None where too little of it is straight there."""
        line, index, sigma = _fit_line(contour, line)
        if len(index) < _FEWEST:
            return None
        points = contour.ideal[index]
        position = points @ np.array([-line[1], line[0]])
        two = points[[int(position.argmin()), int(position.argmax())]]
        ends = two - (two @ line[:2] + line[2])[:, None] * line[:2]
        return _Edge(line, index, sigma, ends, _votes(contour, line, index))


def find_shaft_edges(
    mask: NDArray[np.bool_], contour: Contour, camera: Camera, radius: float, *, seed: int = 0, most: int = 3
) -> tuple[ShaftEdges, ...] | str:
    """Find the shaft's two edges in a mask, or say in words why they cannot be found.

    Pairs of straight contour stretches that face away from each other, have mask between them, and would bound a
    cylinder of ``radius`` (m) at a distance at which an endoscope sees anything: the best supported pair first, then
    up to ``most - 1`` others that share no more than one edge with a better one.
    """
    if len(contour.ideal) < 40:
        return "the mask has too little contour inside the image"
    rng = np.random.default_rng(seed)
    fitted = [_Edge.fit(contour, line) for line in _candidate_lines(contour, rng)]
    edges = sorted((edge for edge in fitted if edge is not None), key=lambda edge: -edge.votes)
    pairs = [
        (_pair_support(edges[j], edges[i], mask.shape), edges[j], edges[i])
        for i in range(len(edges))
        for j in range(i)
        if edges[i].line[:2] @ edges[j].line[:2] < -np.cos(_MOST_APART)
    ]
    chosen: list[ShaftEdges] = []
    best = 0.0
    for support, first, second in sorted(pairs, key=lambda pair: -pair[0]):
        if support <= 0.4 * best or support <= 0 or len(chosen) == most:
            break
        ends = np.stack([first.ends, second.ends])
        if any(np.abs(ends - other.ends).max() < 12 for other in chosen):
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


def _pair_support(first: _Edge, second: _Edge, shape: tuple[int, ...]) -> float:
    """Contour length that two edges explain together as those of the shaft; 0 where they do not lie side by side."""
    direction = np.array([-first.line[1], first.line[0]])
    a, b = first.ends @ direction, (second.ends @ direction)[::-1]  # the edges run in opposite directions
    overlap = min(a[1], b[1]) - max(a[0], b[0])
    middle = (first.ends.sum(axis=0) + second.ends.sum(axis=0)) / 4
    width = -(first.line[:2] @ middle + first.line[2] + second.line[:2] @ middle + second.line[2])
    if width < 6 or overlap < -0.5 * width or min(a[1] - a[0], b[1] - b[0]) < _SHORTEST * width:
        return 0.0
    # The shaft comes in over the image border: edges that begin there are worth more.
    limit = np.array([shape[1] - 1, shape[0] - 1])
    at_border = sum(float(np.minimum(edge.ends, limit - edge.ends).min()) < _AT_BORDER for edge in (first, second))
    shorter, longer = sorted((first.votes, second.votes))
    return float((1.0 + 0.5 * at_border) * (2 * shorter + 0.5 * (longer - shorter)))


def _bounds_cylinder(mask: NDArray[np.bool_], camera: Camera, radius: float, first: _Edge, second: _Edge) -> bool:
    """Whether a cylinder between two edges lies at a likely distance, with instrument between them."""
    ends = np.stack([first.ends, second.ends[::-1]])
    middle = ends.mean(axis=(0, 1))
    direction, point = shaft_axis(_to_planes(np.stack([first.line, second.line]), camera), radius)
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    ray = np.array([*((middle - centre) / focal), 1.0])
    normal = np.cross(direction, np.cross(ray, direction))
    depth = float(normal @ point / (normal @ ray))  # at which the axis passes the middle of the edges
    if not _DEPTHS[0] < depth < _DEPTHS[1]:
        return False
    s, t = (g.reshape(-1, 1) for g in np.meshgrid(np.linspace(0.05, 0.95, 10), np.linspace(0.1, 0.9, 5)))
    sides = ends[:, 0, None] + s * (ends[:, 1] - ends[:, 0])[:, None]
    inside = sides[0] + t * (sides[1] - sides[0])
    pixels = np.rint(camera.distort((inside - centre) / focal) * focal + centre).astype(int)
    seen = (pixels >= 0).all(axis=1) & (pixels < [mask.shape[1], mask.shape[0]]).all(axis=1)
    return bool(seen.any() and mask[pixels[seen, 1], pixels[seen, 0]].mean() >= 0.85)


def shaft_axis(planes: Float64, radius: float) -> tuple[Float64, Float64]:
    """Axis in space of a cylinder that touches two planes through the eye.

    ``planes`` (2, 3) are unit normals pointing out of the cylinder. Returns its unit direction (of either sign) and
    the axis's point nearest to the eye, m, both (3,): the direction lies in both planes, and the axis is ``radius``
    inside of both.
    """
    direction = np.cross(planes[0], planes[1])
    direction /= np.linalg.norm(direction)
    point = np.linalg.solve(np.stack([planes[0], planes[1], direction]), np.array([-radius, -radius, 0.0]))
    return direction, point


def axis_tilt_error(edges: ShaftEdges, camera: Camera, radius: float) -> float:
    """Return the standard deviation, rad, of the axis's direction that the edges leave: mostly its tilt to the eye.

    Short edges fix it badly. Each edge's own angle is uncertain by its spread over its length, eight px of contour
    making one independent point; the axis is computed again with each turned by that much about its middle.
    """
    straight, _ = shaft_axis(edges.planes, radius)
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
        total += float(np.arccos(np.clip(abs(shaft_axis(turned, radius)[0] @ straight), -1, 1))) ** 2
    return float(np.sqrt(total))
