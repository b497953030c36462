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
