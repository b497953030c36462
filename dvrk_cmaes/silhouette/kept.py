"""Meshes prepared for rendering that are kept in the cache on disk: edge topologies, and decimated meshes.

Preparing those of a frame takes about twice as long as loading the instrument. Only instruments that were loaded with
the cache are kept, and a file is found by what the links contain, so that it never belongs to other meshes.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path

from dvrk_cmaes.instrument import Instrument, Link
from dvrk_cmaes.instrument.cache import cache_file, write_kept
from dvrk_cmaes.io.mapped_arrays import UNUSABLE, map_arrays
from dvrk_cmaes.silhouette.decimate import decimate
from dvrk_cmaes.silhouette.topology import MeshTopology, build_topology


def topology_of(instrument: Instrument) -> MeshTopology:
    """Return the edge topology of an instrument, from the cache if it may be kept there and is."""
    path = _path(instrument, "topology")
    if path is not None:
        with contextlib.suppress(*UNUSABLE):
            _, arrays = map_arrays(path)
            return MeshTopology(**{field.name: arrays[field.name] for field in fields(MeshTopology) if field.init})
    topology = build_topology(instrument)
    if path is not None:
        arrays = {field.name: getattr(topology, field.name) for field in fields(topology) if field.init}
        write_kept(path, {}, arrays)
    return topology


def decimated(instrument: Instrument, cell: float) -> tuple[Instrument, float]:
    """Return what `decimate` does, from the cache if it may be kept there and is."""
    path = _path(instrument, "decimated", cell)
    if path is not None:
        with contextlib.suppress(*UNUSABLE):
            document, arrays = map_arrays(path)
            links = tuple(
                Link(link.name, arrays[f"vertices_{i}"], arrays[f"faces_{i}"])
                for i, link in enumerate(instrument.links)
            )
            return replace(instrument, links=links), float(document["error"])
    coarse, error = decimate(instrument, cell)
    if path is not None:
        arrays = {}
        for i, link in enumerate(coarse.links):
            arrays |= {f"vertices_{i}": link.vertices, f"faces_{i}": link.faces}
        write_kept(path, {"error": error}, arrays)
    return coarse, error


def _path(instrument: Instrument, *what: object) -> Path | None:
    """Return the file for what follows from the links of an instrument; None if it is not kept."""
    return cache_file(_digest(instrument.links), *what) if instrument.kept else None


def _digest(links: Iterable[Link]) -> str:
    """Return a digest of the meshes of links."""
    digest = hashlib.sha256()
    for link in links:
        for array in (link.vertices, link.faces):
            digest.update(f"{array.dtype.str}{array.shape}".encode())
            digest.update(array.tobytes())
    return digest.hexdigest()
