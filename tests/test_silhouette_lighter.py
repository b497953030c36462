"""A lighter body: fewer faces, nearly the same silhouette at a low size, and off by no more than it says."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from silhouette_bodies import rigid_instrument

from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.decimate import lightened


@pytest.mark.shared
def test_a_light_body_looks_nearly_the_same_at_a_low_size(scanned_body: Body, clean_frames) -> None:
    light = scanned_body.lightened(3e-4)
    assert len(light.topology.planes) < 0.5 * len(scanned_body.topology.planes)
    assert 0 < light.error_m < 4e-4
    camera, poses = clean_frames.camera.scaled(160, 120), (clean_frames.camera_from_root, clean_frames.joints)
    full, found = (Renderer(body, camera).masks(*poses) for body in (scanned_body, light))
    overlap = (full & found).sum(axis=(1, 2)) / (full | found).sum(axis=(1, 2))
    assert overlap.min() >= 0.99


@pytest.mark.parametrize("cell", [1e-4, 5e-4, 2e-3])
def test_no_vertex_moves_further_than_the_error_says(cell: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    light, error = lightened(rigid_instrument(ball), cell)
    vertices, faces = light.links[0].vertices, light.links[0].faces
    assert 0 <= error <= np.sqrt(3) * cell
    radius = np.linalg.norm(vertices, axis=1)
    assert np.abs(radius - 0.01).max() <= error + 1e-12
    assert all(len(set(face)) == 3 for face in faces.tolist())
    assert len(faces) < len(ball.faces) if cell > 3e-4 else len(faces) == len(ball.faces)


def test_errors_add_up(bundled_body: Body) -> None:
    light = bundled_body.lightened(5e-4)
    assert light.lightened(1e-3).error_m > light.error_m > bundled_body.error_m == 0
