"""Shafts that are cut off outside the image: what remains looks the same, and the cut mesh is part of the whole one."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.pose.search.starts import lookat_pose
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.outline_edges import OutlineEdges
from dvrk_cmaes.silhouette.shortened import cut_off
from dvrk_cmaes.silhouette.spans import LineGrid, covered_spans

PINHOLE = Camera(160, 120, 220.7, 220.7, 110.9, 47.2)
LENS = Camera(160, 120, 206, 225, 99, 61, (-0.3517, 0.7089, 0.0044, -0.0008, -0.9176))
POSE, JOINTS = lookat_pose(0.9, 1.0, -0.7, 0.11), np.array([0.4, -0.3, 0.5])


def poses(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    change = rng.standard_normal((count, 6)) * [0.02, 0.02, 0.03, 0.6, 0.6, 1.0]
    return moved(POSE, change), JOINTS + 0.3 * rng.standard_normal((count, 3))


def spans(body: Body, camera: Camera, links: np.ndarray, *, shortened: bool) -> np.ndarray:
    """Give the covered spans of one pose: row, start and end."""
    topology = body.shortened.topology_for(camera, links) if shortened else body.topology
    found = covered_spans(OutlineEdges(topology, camera, links), LineGrid(camera.height), camera.width)
    long = found.end - found.start > 1e-3
    return np.stack([found.row[long], found.start[long], found.end[long]], axis=1)


@pytest.mark.parametrize("camera", [PINHOLE, LENS], ids=["pinhole", "lens"])
def test_image_is_the_same(bundled_body: Body, camera: Camera) -> None:
    cut = 0
    for links in bundled_body.camera_from_links(*poses()):
        cut += bundled_body.shortened.topology_for(camera, links[None]) is not bundled_body.topology
        one, other = (spans(bundled_body, camera, links[None], shortened=way) for way in (True, False))
        np.testing.assert_allclose(one, other, atol=2e-3)
    assert cut > 20


def test_shaft_in_the_image_is_kept(bundled_body: Body) -> None:
    far = lookat_pose(0.1, 0.0, 1.3, 0.6)
    links = bundled_body.camera_from_links(far[None], JOINTS[None])
    assert bundled_body.shortened.topology_for(PINHOLE, links) is bundled_body.topology


def test_batch_keeps_what_any_of_its_poses_shows(bundled_body: Body) -> None:
    both = np.stack([POSE, lookat_pose(0.1, 0.0, 1.3, 0.6)])
    together = Renderer(bundled_body, PINHOLE).masks(both, np.tile(JOINTS, (2, 1)))
    for pose, mask in zip(both, together, strict=True):
        np.testing.assert_array_equal(Renderer(bundled_body, PINHOLE).masks(pose[None], JOINTS[None])[0], mask)


def test_cut_mesh_lies_on_the_whole_one(bundled_body: Body) -> None:
    link, shaft = bundled_body.instrument.links[0], bundled_body.instrument.shaft
    assert shaft is not None
    found = cut_off(link, shaft.point, shaft.direction, -0.05)
    along = (found.vertices - shaft.point) @ shaft.direction
    assert along.min() == pytest.approx(-0.05, abs=1e-12)
    assert along.max() == pytest.approx(((link.vertices - shaft.point) @ shaft.direction).max())

    def area_ahead(vertices: np.ndarray, faces: np.ndarray) -> float:
        """Give the area of the faces that lie wholly ahead of the plane."""
        ahead = ((vertices - shaft.point) @ shaft.direction >= -0.05 - 1e-12)[faces].all(axis=1)
        a, b, c = vertices[faces[ahead]].swapaxes(0, 1)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    rest = cut_off(link, shaft.point, -shaft.direction, 0.05)
    a, b, c = rest.vertices[rest.faces].swapaxes(0, 1)
    behind = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    a, b, c = link.vertices[link.faces].swapaxes(0, 1)
    whole = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    assert area_ahead(found.vertices, found.faces) + behind == pytest.approx(whole, rel=1e-9)
