"""Decimated bodies: fewer faces, nearly the same silhouette at low resolution, and a valid error bound."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from helpers.silhouette_bodies import rigid_instrument

from dvrk_cmaes import Body, Renderer
from dvrk_cmaes.silhouette.decimate import decimate


def test_decimated_silhouette_is_nearly_the_same(scanned_body: Body, clean_frames) -> None:
    coarse = scanned_body.decimated(3e-4)
    assert coarse.mesh.edges < 0.5 * scanned_body.mesh.edges
    assert 0 < coarse.error_m < 4e-4
    camera, poses = clean_frames.camera.scaled(160, 120), (clean_frames.camera_from_root, clean_frames.joints)
    full, found = (Renderer(body, camera).masks(*poses) for body in (scanned_body, coarse))
    overlap = (full & found).sum(axis=(1, 2)) / (full | found).sum(axis=(1, 2))
    assert overlap.min() >= 0.99


@pytest.mark.parametrize("cell", [1e-4, 5e-4, 2e-3])
def test_vertices_move_at_most_by_stated_error(cell: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    coarse, error = decimate(rigid_instrument(ball), cell)
    vertices, faces = coarse.links[0].vertices, coarse.links[0].faces
    assert 0 <= error <= np.sqrt(3) * cell
    radius = np.linalg.norm(vertices, axis=1)
    assert np.abs(radius - 0.01).max() <= error + 1e-12
    assert all(len(set(face)) == 3 for face in faces.tolist())
    assert len(faces) < len(ball.faces) if cell > 3e-4 else len(faces) == len(ball.faces)


@pytest.mark.parametrize(("radius", "cell"), [(0.01, 5e-4), (5.0, 1e-6)])
def test_vertices_are_in_the_order_of_their_cells(radius: float, cell: float) -> None:
    # 10^7 cells along each axis: a number for each of them does not fit into 64 bits
    coarse, _ = decimate(rigid_instrument(trimesh.creation.icosphere(subdivisions=3, radius=radius)), cell)
    cells = np.floor(coarse.links[0].vertices / cell).astype(np.int64)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert np.array_equal(np.lexsort(cells.T[::-1]), np.arange(len(cells)))


def test_errors_of_repeated_decimation_add_up(bundled_body: Body) -> None:
    coarse = bundled_body.decimated(5e-4)
    assert coarse.decimated(1e-3).error_m > coarse.error_m > bundled_body.error_m == 0
