"""Reader of mesh files (STL, OBJ, DAE, PLY) as welded triangle meshes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError, one_line
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.instrument.dae_size import check_dae_size
from dvrk_cmaes.instrument.mesh_header import check_header_sizes
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.plain_xml import parse_xml

#: Suffixes of the mesh formats that can be read.
SUFFIXES = (".stl", ".obj", ".dae", ".ply")

#: Largest extent of one mesh that is accepted, m; a larger one is likely to be in millimetres.
LARGEST_EXTENT = 5.0

_LARGEST = 500_000_000  # bytes; meshes of scanned instruments have about ten million
_LARGEST_COORDINATE = 1e9
_WELD = 1e-8  # grid size for merging vertices, as a fraction of the bounding box's diagonal
_FLAT = 1e-7  # height / longest side below which a triangle is degenerate; the resolution of float32

Triangles = tuple[Float64, NDArray[np.int32]]


def read_mesh(path: Path) -> Triangles:
    """Read a mesh file as welded triangles, in the file's units (DAE: in metres).

    Returns
    -------
    vertices : (V, 3) float64
    faces : (F, 3) int32
        Vertices are welded; there are no degenerate or repeated faces.

    Raises
    ------
    InputError
        The file cannot be read, is of an unknown format or a Git LFS pointer, has no faces, or has coordinates that
        are not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: cannot read a mesh of kind {suffix!r}; expected one of {', '.join(SUFFIXES)}")
    data = read_bytes(path, expected="a mesh file", largest=_LARGEST)
    check_header_sizes(path, data)
    try:
        places, corners = _read_ply(path) if suffix == ".ply" else _read_with_trimesh(path, data)
    except InputError:
        raise
    except Exception as error:  # the parsers raise exceptions of many types, e.g. struct.error, AttributeError
        raise InputError(f"{path}: cannot be read as {suffix[1:].upper()}: {one_line(error)}") from None
    if len(places) == 0 or len(corners) == 0:
        raise InputError(f"{path}: an empty mesh: {len(places)} vertices, {len(corners)} faces; expected a surface")
    if corners.min() < 0 or corners.max() >= len(places):
        raise InputError(f"{path}: faces refer to vertices that do not exist (there are {len(places)})")
    if not (np.abs(places) < _LARGEST_COORDINATE).all():
        raise InputError(f"{path}: vertices: expected finite coordinates, got NaN, infinity or over 1e9")
    vertices, faces = weld(places, corners)
    if len(faces) == 0:
        raise InputError(f"{path}: an empty mesh: every face is degenerate (no area)")
    return vertices, faces


def _read_ply(path: Path) -> tuple[Float64, NDArray[np.int64]]:
    """Read a PLY; polygons with more than three corners become triangle fans about their first corner."""
    from plyfile import PlyData, PlyElementParseError

    names = ("vertex_indices", "vertex_index")
    try:  # much faster, if all faces are triangles
        ply: Any = PlyData.read(str(path), known_list_len={"face": dict.fromkeys(names, 3)})
    except (PlyElementParseError, ValueError):
        ply = PlyData.read(str(path))
    corners = ply["vertex"]
    vertices = np.stack([np.asarray(corners[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    if "face" not in ply or len(ply["face"].data) == 0:
        return vertices, np.empty((0, 3), dtype=np.int64)
    present = [name for name in names if name in ply["face"].data.dtype.names]
    if not present:
        raise InputError(f"{path}: element face: expected a list property vertex_indices")
    polygons = ply["face"].data[present[0]]
    if polygons.ndim == 2:  # all are triangles
        return vertices, np.array(polygons, dtype=np.int64)
    fans = [_fan(np.asarray(polygon, dtype=np.int64)) for polygon in polygons]
    return vertices, np.concatenate(fans)


def _fan(polygon: NDArray[np.int64]) -> NDArray[np.int64]:
    """Split a polygon (N,) of vertex indices into triangles (N - 2, 3) about its first corner."""
    first = np.full(max(len(polygon) - 2, 0), polygon[0] if len(polygon) else 0)
    return np.stack([first, polygon[1:-1][: len(first)], polygon[2:][: len(first)]], axis=1)


def _read_with_trimesh(path: Path, data: bytes) -> tuple[Float64, NDArray[np.int64]]:
    """Read STL, OBJ or DAE; a DAE file states its unit and is converted to metres."""
    import trimesh

    suffix = path.suffix.lower()
    unit = _dae_unit(path, data) if suffix == ".dae" else 1.0
    # as data instead of a path, so that no file that it names, such as a texture, is opened
    scene: Any = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=True)
    mesh: Any = scene.to_mesh()
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    return unit * vertices, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)


def _dae_unit(path: Path, data: bytes) -> float:
    """Read the metres per unit of a DAE file, which trimesh ignores; a URDF ignores the file's up axis."""
    root = parse_xml(path, data)
    check_dae_size(path, root)
    unit = root.find("{*}asset/{*}unit")
    metres = float(unit.get("meter", "1")) if unit is not None else 1.0
    if not (np.isfinite(metres) and metres > 0):
        raise InputError(f"{path}: asset unit: expected a positive number of metres, got {metres}")
    return metres


def weld(vertices: Float64, faces: NDArray[Any]) -> Triangles:
    """Merge coincident vertices; remove degenerate and repeated faces, and vertices without a face.

    Parameters
    ----------
    vertices : (V, 3)
        Positions.
    faces : (F, 3)
        Vertex indices.

    Returns
    -------
    vertices, faces
        Arrays of the same kind with at most as many rows; the order and winding of the faces are kept.
    """
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if diagonal == 0.0:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int32)
    cells = np.round((vertices - vertices.min(axis=0)) / (_WELD * diagonal)).astype(np.int64)
    _, first, group = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    merged = group.reshape(-1)[faces]
    places = vertices[first]
    corner = places[merged]
    sides = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    doubled = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    merged = merged[doubled > _FLAT * sides.max(axis=1, initial=0.0) ** 2]
    _, distinct = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    merged = merged[np.sort(distinct)]
    used, renumbered = np.unique(merged, return_inverse=True)
    return places[used], renumbered.reshape(-1, 3).astype(np.int32)


def to_link_frame(triangles: Triangles, link_from_mesh: Float64, scale: Float64) -> Triangles:
    """Scale a mesh and transform it into its link's frame.

    Parameters
    ----------
    triangles
        Vertices (V, 3) and faces (F, 3).
    link_from_mesh : (4, 4)
        Pose of the scaled mesh in the link's frame.
    scale : (3,)
        Factor along each axis. If their product is negative, the winding of the faces is reversed, so that normals
        still point outwards.
    """
    vertices, faces = triangles
    moved = apply(link_from_mesh, vertices * scale)
    return moved, np.ascontiguousarray(faces[:, ::-1] if np.prod(scale) < 0 else faces)
