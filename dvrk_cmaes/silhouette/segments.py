"""Straight outline segments in the image, and the subdivision of those that lens distortion bends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.silhouette.grid import Float32, LineGrid, Projection
from dvrk_cmaes.silhouette.scenes import NEAR

_BEND = 0.004  # px; a segment that the lens bends by less is treated as straight
_EXACT_BEND = 0.0005  # px; the same where it is asked which pixels' centres are covered


@dataclass(frozen=True, eq=False)
class Segments:
    """Outline edges or parts of them, for a batch of poses; the rows of (2, S) arrays are start and end."""

    pose: NDArray[np.intp]
    """(S,) the pose's index in the batch."""
    face: NDArray[np.intp]
    """(S,) index of the face whose boundary runs from start to end."""
    weight: NDArray[np.int8]
    """(S,) magnitude of the change of the layer count across the segment."""
    u: Float32
    """(2, S) position along the lines."""
    v: Float32
    """(2, S) line number as a real number."""
    line: NDArray[np.signedinteger[Any]]
    """(2, S) number of the first line at or below the point, clipped to the image."""
    xy: Float32 | None = None
    """(2, 2, S) undistorted normalised coordinates x and y of start and end; None for a pinhole."""
    inverse_depth: Float32 | None = None
    """(2, S) 1 / z, 1/m; None unless requested."""

    def select(self, which: NDArray[np.integer[Any]]) -> Segments:
        """Return the segments with the given indices."""

        def some(values: NDArray[Any]) -> Any:
            return values.take(which, axis=-1, mode="clip")

        return Segments(
            some(self.pose),
            some(self.face),
            some(self.weight),
            some(self.u),
            some(self.v),
            some(self.line),
            None if self.xy is None else some(self.xy),
            None if self.inverse_depth is None else some(self.inverse_depth),
        )

    def crossing(self) -> Segments:
        """Return the segments that cross at least one line."""
        return self.select(np.flatnonzero(self.line[0] != self.line[1]))

    def on_near_plane(self) -> NDArray[np.bool_]:
        """Return which segments lie in the near plane, where it cuts a face, (S,)."""
        assert self.inverse_depth is not None
        return np.asarray((self.inverse_depth >= np.float32(1 / NEAR)).all(axis=0))

    def concatenated(self, other: Segments) -> Segments:
        """Return these segments followed by others."""

        def both(first: NDArray[Any], second: NDArray[Any]) -> Any:
            return np.concatenate([first, second], axis=-1)

        inverse = self.inverse_depth, other.inverse_depth
        return Segments(
            both(self.pose, other.pose),
            both(self.face, other.face),
            both(self.weight, other.weight),
            both(self.u, other.u),
            both(self.v, other.v),
            both(self.line, other.line),
            None if self.xy is None or other.xy is None else both(self.xy, other.xy),
            None if inverse[0] is None or inverse[1] is None else both(inverse[0], inverse[1]),
        )


@lru_cache(maxsize=64)
def _straight_length(camera: Camera, allowed: float) -> float:
    """Return the length, px, up to which the lens bends a segment by less than ``allowed`` px anywhere in the image."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 17), np.linspace(-0.5, camera.height - 0.5, 17))
    middle = camera.normalise(np.stack([u, v], axis=-1))
    focal = np.array([camera.fx, camera.fy])
    turn = np.arange(8)[:, None, None, None] * np.pi / 8
    half = 2.0 * np.concatenate([np.cos(turn), np.sin(turn)], axis=-1) / focal
    start, end = camera.distort(middle - half) * focal, camera.distort(middle + half) * focal
    chord, off = end - start, camera.distort(middle) * focal - (start + end) / 2
    bend = np.abs(chord[..., 0] * off[..., 1] - chord[..., 1] * off[..., 0]) / np.linalg.norm(chord, axis=-1)
    return float(4.0 * np.sqrt(allowed / max(bend.max(), 1e-9)))


def subdivided(segments: Segments, projection: Projection, grid: LineGrid, *, exact: bool = False) -> Segments:
    """Divide the segments that lens distortion may bend; return those that cross lines.

    They are divided where that may be by more than ``_BEND`` or, for ``exact`` ones, ``_EXACT_BEND``.
    """
    assert segments.xy is not None
    focal = np.array([[projection.camera.fx], [projection.camera.fy]], dtype=np.float32)
    straight = _straight_length(projection.camera, _EXACT_BEND if exact else _BEND)
    delta = (segments.xy[:, 1] - segments.xy[:, 0]) * focal
    is_long = np.einsum("is,is->s", delta, delta) > straight**2
    short = segments.select(np.flatnonzero((segments.line[0] != segments.line[1]) & ~is_long))
    if not is_long.any():
        return short
    return short.concatenated(_subdivide(segments.select(np.flatnonzero(is_long)), projection, grid, straight))


def _subdivide(segments: Segments, projection: Projection, grid: LineGrid, straight: float) -> Segments:
    """Divide segments into parts at most ``straight`` px long, within the domain of the lens model."""
    assert segments.xy is not None
    start, end = segments.xy.astype(np.float64).transpose(1, 2, 0)
    focal = np.array([projection.camera.fx, projection.camera.fy])
    # Clip each segment to the square around the circle in which the lens model is applied without extrapolation.
    reach = projection.camera.lens_radius
    delta = end - start
    safe = np.where(np.abs(delta) < 1e-12, 1e-12, delta)
    t = np.sort(np.stack([(-reach - start) / safe, (reach - start) / safe]), axis=0)
    enter, leave = np.clip(t[0].max(axis=1), 0, 1), np.clip(t[1].min(axis=1), 0, 1)
    leave = np.maximum(leave, enter)
    pieces = np.ceil(np.linalg.norm(delta * focal, axis=1) * (leave - enter) / straight).astype(np.int64)
    # Each segment becomes a chain of points: its start, the entry into the square, the divisions, the exit, its end.
    inner = pieces + 1
    owner = np.repeat(np.arange(len(inner)), inner)
    rank = np.arange(len(owner)) - (np.cumsum(inner) - inner)[owner]
    share = enter[owner] + (leave - enter)[owner] * rank / np.maximum(pieces[owner], 1)
    at = (start[owner] + share[:, None] * delta[owner]).T.astype(np.float32)
    u, v = grid.place(projection.pixels(at))
    last = np.cumsum(inner + 2) - 1
    first = last - inner - 1
    place = first[owner] + 1 + rank
    part = np.delete(np.arange(last[-1] + 1), last)  # every point except a segment's last is the start of a part

    def chain(ends: NDArray[Any], between: NDArray[Any]) -> NDArray[Any]:
        points = np.empty(last[-1] + 1, dtype=ends.dtype)
        points[first], points[last] = ends
        points[place] = between
        return np.stack([points[part], points[part + 1]])

    line = chain(segments.line, grid.first_line(v))
    inverse = segments.inverse_depth
    if inverse is not None:  # 1 / z is linear along a straight line in the undistorted image
        inverse = chain(inverse, inverse[0, owner] + share * (inverse[1] - inverse[0])[owner])
    return Segments(
        np.repeat(segments.pose, inner + 1),
        np.repeat(segments.face, inner + 1),
        np.repeat(segments.weight, inner + 1),
        chain(segments.u, u),
        chain(segments.v, v),
        line,
        inverse_depth=inverse,
    ).crossing()
