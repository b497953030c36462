"""Straight segments of outline in the image, and what becomes of those that a lens bends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.grid import Float32, LineGrid, Projection
from dvrk_cmaes.silhouette.scenes import NEAR

_BEND = 0.0005  # pixels by which a lens may bend a segment that is drawn straight


@dataclass(frozen=True, eq=False)
class Segments:
    """Outline edges, or parts of them, between two points of the image: rows of start and end."""

    lane: NDArray[np.intp]
    face: NDArray[np.intp]
    """(S,) the face whose boundary runs from start to end."""
    weight: NDArray[np.int8]
    """(S,) by how much the layer count changes across the segment."""
    u: Float32
    """(2, S) position along the lines."""
    v: Float32
    """(2, S) line number, a real number."""
    line: NDArray[np.signedinteger[Any]]
    """(2, S) the first line at or below the point, within the image."""
    xy: Float32 | None = None
    """(2, 2, S) undistorted normalised coordinates x and y of start and end, where a lens bends lines."""
    inverse_depth: Float32 | None = None
    """(2, S) 1 / z, where asked for."""

    def select(self, which: NDArray[np.integer[Any]]) -> Segments:
        """Keep some of the segments."""

        def some(values: NDArray[Any]) -> Any:
            return values.take(which, axis=-1, mode="clip")

        return Segments(
            some(self.lane),
            some(self.face),
            some(self.weight),
            some(self.u),
            some(self.v),
            some(self.line),
            None if self.xy is None else some(self.xy),
            None if self.inverse_depth is None else some(self.inverse_depth),
        )

    def crossing(self) -> Segments:
        """Keep those that cross a line."""
        return self.select(np.flatnonzero(self.line[0] != self.line[1]))

    def on_near_plane(self) -> NDArray[np.bool_]:
        """(S,) which run along the near plane, where it cuts a face."""
        assert self.inverse_depth is not None
        return np.asarray((self.inverse_depth >= np.float32(1 / NEAR)).all(axis=0))

    def and_more(self, more: Segments) -> Segments:
        """Append segments."""

        def both(one: NDArray[Any], other: NDArray[Any]) -> Any:
            return np.concatenate([one, other], axis=-1)

        mine, others = self.inverse_depth, more.inverse_depth
        inverse = None if mine is None or others is None else both(mine, others)
        return Segments(
            both(self.lane, more.lane),
            both(self.face, more.face),
            both(self.weight, more.weight),
            both(self.u, more.u),
            both(self.v, more.v),
            both(self.line, more.line),
            None if self.xy is None or more.xy is None else both(self.xy, more.xy),
            inverse,
        )


@lru_cache(maxsize=64)
def _straight_length(camera: Camera) -> float:
    """Length in pixels up to which the lens bends a segment by less than ``_BEND`` wherever it is in the image."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 17), np.linspace(-0.5, camera.height - 0.5, 17))
    middle = camera.normalise(np.stack([u, v], axis=-1))
    focal = np.array([camera.fx, camera.fy])
    turn = np.arange(8)[:, None, None, None] * np.pi / 8
    half = 2.0 * np.concatenate([np.cos(turn), np.sin(turn)], axis=-1) / focal
    start, end = camera.distort(middle - half) * focal, camera.distort(middle + half) * focal
    way, off = end - start, camera.distort(middle) * focal - (start + end) / 2
    bend = np.abs(way[..., 0] * off[..., 1] - way[..., 1] * off[..., 0]) / np.linalg.norm(way, axis=-1)
    return float(4.0 * np.sqrt(_BEND / max(bend.max(), 1e-9)))


def bent(segments: Segments, projection: Projection, grid: LineGrid) -> Segments:
    """Divide segments that a lens may bend visibly into short ones, inside the image's surroundings."""
    assert segments.xy is not None
    focal = np.array([[projection.camera.fx], [projection.camera.fy]], dtype=np.float32)
    straight = _straight_length(projection.camera)
    way = (segments.xy[:, 1] - segments.xy[:, 0]) * focal
    is_long = np.einsum("is,is->s", way, way) > straight**2
    short = segments.select(np.flatnonzero((segments.line[0] != segments.line[1]) & ~is_long))
    if not is_long.any():
        return short
    return short.and_more(_divided(segments.select(np.flatnonzero(is_long)), projection, grid, straight))


def _divided(segments: Segments, projection: Projection, grid: LineGrid, straight: float) -> Segments:
    """Divide segments into parts of at most a given length, px."""
    assert segments.xy is not None
    start, end = segments.xy.astype(np.float64).transpose(1, 2, 0)
    focal = np.array([projection.camera.fx, projection.camera.fy])
    # The part of each within the square around the circle where the lens model is used as written.
    reach = projection.camera.lens_radius
    way = end - start
    safe = np.where(np.abs(way) < 1e-12, 1e-12, way)
    t = np.sort(np.stack([(-reach - start) / safe, (reach - start) / safe]), axis=0)
    enter, leave = np.clip(t[0].max(axis=1), 0, 1), np.clip(t[1].min(axis=1), 0, 1)
    leave = np.maximum(leave, enter)
    pieces = np.ceil(np.linalg.norm(way * focal, axis=1) * (leave - enter) / straight).astype(np.int64)
    # Each segment becomes a chain of points: its start, where it enters, the divisions, where it leaves, its end.
    inner = pieces + 1
    owner = np.repeat(np.arange(len(inner)), inner)
    rank = np.arange(len(owner)) - (np.cumsum(inner) - inner)[owner]
    share = enter[owner] + (leave - enter)[owner] * rank / np.maximum(pieces[owner], 1)
    at = (start[owner] + share[:, None] * way[owner]).T.astype(np.float32)
    u, v = grid.place(projection.pixels(at))
    last = np.cumsum(inner + 2) - 1
    first = last - inner - 1
    place = first[owner] + 1 + rank
    part = np.delete(np.arange(last[-1] + 1), last)  # each point but a segment's last begins a part

    def chain(ends: NDArray[Any], between: NDArray[Any]) -> NDArray[Any]:
        points = np.empty(last[-1] + 1, dtype=ends.dtype)
        points[first], points[last] = ends
        points[place] = between
        return np.stack([points[part], points[part + 1]])

    line = chain(segments.line, grid.first_line(v))
    inverse = segments.inverse_depth
    if inverse is not None:  # linear along a straight line in the image
        inverse = chain(inverse, inverse[0, owner] + share * (inverse[1] - inverse[0])[owner])
    return Segments(
        np.repeat(segments.lane, inner + 1),
        np.repeat(segments.face, inner + 1),
        np.repeat(segments.weight, inner + 1),
        chain(segments.u, u),
        chain(segments.v, v),
        line,
        inverse_depth=inverse,
    ).crossing()
