"""A lighter instrument for coarse images: fewer, larger faces, and how far its surface can be off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument import Instrument, Link


def lightened(instrument: Instrument, cell: float) -> tuple[Instrument, float]:
    """Join the vertices of each link that share a cubic cell of a grid, ``cell`` m wide, in their mean.

    Gives the instrument and the largest distance, m, by which a vertex has moved. No point of the surface moves
    further: it lies between a face's corners. So in the image, the outline is off by that times focal length over
    depth at most.
    """
    links, errors = zip(*(_joined(link, cell) for link in instrument.links), strict=True)
    return replace(instrument, links=links), max(errors)


def _joined(link: Link, cell: float) -> tuple[Link, float]:
    _, group = np.unique(np.floor(link.vertices / cell).astype(np.int64), axis=0, return_inverse=True)
    group = group.ravel()
    size = np.bincount(group)
    vertices = np.stack([np.bincount(group, weights=column) for column in link.vertices.T], axis=1) / size[:, None]
    faces: NDArray[np.int32] = group[link.faces].astype(np.int32)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    moved = float(np.linalg.norm(vertices[group] - link.vertices, axis=1).max())
    return Link(link.name, vertices, np.ascontiguousarray(faces[np.sort(once)])), moved
