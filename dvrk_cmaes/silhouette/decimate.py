"""Mesh decimation by vertex clustering, for rendering at low image resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument import Instrument, Link

_LARGEST = 1 << 62  # number of different rows, up to which each has a number of 64 bits


def decimate(instrument: Instrument, cell: float) -> tuple[Instrument, float]:
    """Replace the vertices of each link within a cubic grid cell, ``cell`` m wide, by their mean.

    Returns the instrument and the largest distance, m, by which a vertex moved. This distance also bounds the motion
    of every other point of the surface, because these are convex combinations of vertices. The error of the outline in
    the image is therefore at most this distance times focal length over depth.
    """
    links, errors = zip(*(_decimate_link(link, cell) for link in instrument.links), strict=True)
    return replace(instrument, links=links), max(errors)


def _decimate_link(link: Link, cell: float) -> tuple[Link, float]:
    cells = np.floor(link.vertices / cell).astype(np.int64)
    _, group = np.unique(_keys(cells - cells.min(axis=0)), return_inverse=True)
    size = np.bincount(group)
    vertices = np.stack([np.bincount(group, weights=column) for column in link.vertices.T], axis=1) / size[:, None]
    faces: NDArray[np.int32] = group[link.faces].astype(np.int32)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, once = np.unique(_keys(np.sort(faces, axis=1).astype(np.int64)), return_index=True)
    moved = float(np.linalg.norm(vertices[group] - link.vertices, axis=1).max())
    return Link(link.name, vertices, np.ascontiguousarray(faces[np.sort(once)])), moved


def _keys(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each row (N, 3) of numbers from 0 on, in their order; `np.unique` is faster on it."""
    first, second, third = (rows.max(axis=0, initial=0) + 1).tolist()
    if first * second * third >= _LARGEST:
        return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1]).ravel()
    return np.asarray((rows[:, 0] * second + rows[:, 1]) * third + rows[:, 2])
