"""Visual geometry of a link: mesh files and primitives as triangles in the link's frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.locate import find_mesh
from dvrk_cmaes.instrument.meshes import LARGEST_EXTENT, Triangles, read_mesh, to_link_frame, weld

_CYLINDER_SIDES = 64
_MOST_VISUALS = 100  # of a link
_LEAST_SCALE = 1e-9
_LEAST_EXTENT = 1e-7  # m, of a primitive


def link_triangles(
    visuals: Sequence[Any], link: str, urdf: Path, packages: Mapping[str, Path], cache: dict[Path, Triangles]
) -> Triangles | None:
    """Return the triangles of all visuals of one link in the link's frame; None if it has no geometry.

    Parameters
    ----------
    visuals
        The link's visuals as read by yourdfpy.
    link
        Name of the link, for messages.
    urdf
        Path of the URDF; relative mesh paths are relative to its folder.
    packages
        Folder of each known ROS package, by name.
    cache
        Meshes read so far, by path; meshes read here are added.

    Raises
    ------
    InputError
        A mesh is missing or cannot be used, the numbers of a primitive or an origin are not valid, or there are more
        than 100 visuals.
    """
    if len(visuals) > _MOST_VISUALS:
        raise InputError(f"{urdf}: link {link!r}: expected at most {_MOST_VISUALS} visuals, got {len(visuals)}")
    parts: list[Triangles] = []
    for visual in visuals:
        where = f"{urdf}: link {link!r}"
        origin = np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)
        if not (np.abs(origin) <= LARGEST_EXTENT).all():
            raise InputError(f"{where}: visual origin: expected numbers of at most {LARGEST_EXTENT:g} m")
        geometry = visual.geometry
        if geometry.mesh is not None:
            parts.append(_mesh(geometry.mesh, where, urdf, packages, cache, origin))
        else:
            primitive = _primitive(geometry, where)
            if primitive is not None:
                parts.append(to_link_frame(primitive, origin, np.ones(3)))
    if not parts:
        return None
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=False)])
    return np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int32)


def _mesh(
    mesh: Any, where: str, urdf: Path, packages: Mapping[str, Path], cache: dict[Path, Triangles], origin: Float64
) -> Triangles:
    """Read the mesh of a visual and transform it into the link's frame."""
    if not mesh.filename:
        raise InputError(f"{where}: mesh: expected a filename")
    path = find_mesh(mesh.filename, urdf, packages, where)
    if path not in cache:
        cache[path] = read_mesh(path)
    scale = np.atleast_1d(np.asarray(1.0 if mesh.scale is None else mesh.scale, dtype=np.float64))
    scale = np.repeat(scale, 3) if len(scale) == 1 else scale
    if scale.shape != (3,) or not ((np.abs(scale) >= _LEAST_SCALE) & (np.abs(scale) <= 1 / _LEAST_SCALE)).all():
        raise InputError(f"{where}: mesh {mesh.filename}: scale: expected three finite numbers, none zero")
    placed = to_link_frame(cache[path], origin, scale)
    extent = float(np.ptp(placed[0], axis=0).max())
    if extent > LARGEST_EXTENT:
        raise InputError(
            f"{path}: {extent:.4g} m across; expected at most {LARGEST_EXTENT:g} m "
            '(a mesh in millimetres? then give scale="0.001 0.001 0.001" in the URDF)'
        )
    return placed


def _primitive(geometry: Any, where: str) -> Triangles | None:
    """Triangulate a box, cylinder or sphere about its centre; None for a placeholder of size zero."""
    import trimesh

    if geometry.box is not None:
        kind, count, sizes = "box", 3, np.asarray(geometry.box.size, dtype=np.float64)
    elif geometry.cylinder is not None:
        kind, count, sizes = "cylinder", 2, np.array([geometry.cylinder.radius, geometry.cylinder.length])
    else:
        kind, count, sizes = "sphere", 1, np.array([geometry.sphere.radius])
    if sizes.shape != (count,) or not np.isfinite(sizes).all() or np.any(sizes < 0):
        raise InputError(f"{where}: {kind}: expected finite sizes, not negative, got {sizes.tolist()}")
    if np.any(sizes == 0):
        return None
    if sizes.min() < _LEAST_EXTENT:
        raise InputError(f"{where}: {kind}: {sizes.min():.4g} m; expected at least {_LEAST_EXTENT:g} m, or 0 for none")
    if sizes.max() > LARGEST_EXTENT:
        raise InputError(f"{where}: {kind}: {sizes.max():.4g} m; expected at most {LARGEST_EXTENT:g} m (millimetres?)")
    solid: Any
    if kind == "box":
        solid = trimesh.creation.box(extents=sizes)
    elif kind == "cylinder":
        solid = trimesh.creation.cylinder(radius=sizes[0], height=sizes[1], sections=_CYLINDER_SIDES)
    else:
        solid = trimesh.creation.icosphere(subdivisions=3, radius=sizes[0])
    return weld(np.asarray(solid.vertices, dtype=np.float64), np.asarray(solid.faces))
