"""Masks from outline crossings agree with masks traced pixel by pixel, for all poses, lenses and meshes."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import trimesh
from helpers.silhouette_bodies import rigid_instrument, surface
from helpers.transforms import apply, exp_rotation, transform
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dvrk_cmaes import Body, Camera, DvrkCmaesError, Renderer

NEAR = 1e-3
"""Distance from the camera's plane, m, within which nothing is drawn."""

CAMERAS = {
    "pinhole": Camera(160, 120, 220.7, 220.7, 110.9, 47.2),
    "plumb_bob": Camera(160, 120, 206, 225, 99, 61, (-0.3517, 0.7089, 0.0044, -0.0008, -0.9176)),
    "rational": Camera(
        160, 120, 206, 206, 80, 60, (0.3, -0.2, 0.001, -0.002, 0.05, 0.4, -0.1, 0.02), "rational_polynomial"
    ),
    "equidistant": Camera(160, 120, 80, 80, 80, 60, (-0.02, 0.01, 0.0, 0.0), "equidistant"),
}
FULL_SIZE = {
    "pinhole": Camera(640, 480, 882.996, 882.996, 445.06, 190.24),
    "plumb_bob": CAMERAS["plumb_bob"].scaled(640, 480),
    "equidistant": CAMERAS["equidistant"].scaled(640, 480),
}
EACH = 8
"""Number of poses for each kind, camera and body."""


# Kinds of poses


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    axis = rng.standard_normal((count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return exp_rotation(axis * rng.uniform(0, np.pi, (count, 1)))


def random_joints(body: Body, rng: np.random.Generator, count: int) -> np.ndarray:
    low, high = body.instrument.limits.T
    return rng.uniform(low, high, (count, len(low)))


def link_depths(body: Body, pose: np.ndarray, joints: np.ndarray) -> list[np.ndarray]:
    """Give the depths of the vertices of each link, m."""
    links = body.camera_from_links(pose[None], joints[None])[0]
    return [link.vertices @ one[2, :3] + one[2, 3] for link, one in zip(body.instrument.links, links, strict=True)]


def in_view(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    shift = rng.uniform([-0.02, -0.02, 0.05], [0.02, 0.02, 0.2], (EACH, 3))
    return transform(random_rotations(rng, EACH), shift), random_joints(body, rng, EACH)


def through_the_camera_plane(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    count = 20 * EACH
    rotation, joints = random_rotations(rng, count), random_joints(body, rng, count)
    on_shaft = np.c_[np.zeros((count, 2)), rng.uniform(-0.1, 0, count)]
    seen_at = rng.uniform([-0.3, -0.2, 1], [0.2, 0.3, 1], (count, 3)) * rng.uniform(0.01, 0.05, (count, 1))
    poses = transform(rotation, seen_at - np.einsum("nij,nj->ni", rotation, on_shaft))
    cut = [any(d.min() < NEAR < d.max() for d in link_depths(body, *one)) for one in zip(poses, joints, strict=True)]
    chosen = np.flatnonzero(cut)[:EACH]
    assert len(chosen) == EACH
    return poses[chosen], joints[chosen]


def eye_inside_the_shaft(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    eye = rng.uniform([-0.002, -0.002, -0.2], [0.002, 0.002, -0.03], (EACH, 3))
    rotation = random_rotations(rng, EACH)
    return transform(rotation, -np.einsum("nij,nj->ni", rotation, eye)), random_joints(body, rng, EACH)


def thinner_than_a_pixel(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    depth = rng.uniform(1.5, 4, (EACH, 1))
    shift = np.c_[rng.uniform(-0.1, 0.1, (EACH, 2)), np.ones(EACH)] * depth
    return transform(random_rotations(rng, EACH), shift), random_joints(body, rng, EACH)


def beside_the_image(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    around = rng.uniform(0, 2 * np.pi, EACH)
    off = rng.uniform(0.1, 3, EACH)
    shift = np.stack([off * np.cos(around), off * np.sin(around), rng.uniform(-0.3, 0.3, EACH)], axis=1)
    return transform(random_rotations(rng, EACH), shift), random_joints(body, rng, EACH)


def on_the_border(body: Body, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    x, y = [(-0.5, 0), (0.32, 0), (0, -0.25), (0, 0.35)][rng.integers(4)]
    shift = np.array([x, y, 1]) * rng.uniform(0.04, 0.12, (EACH, 1))
    return transform(random_rotations(rng, EACH), shift), random_joints(body, rng, EACH)


KINDS = [
    in_view,
    through_the_camera_plane,
    eye_inside_the_shaft,
    thinner_than_a_pixel,
    beside_the_image,
    on_the_border,
]


def assert_masks_are_traced(renderer: Renderer, poses: np.ndarray, joints: np.ndarray, *, most: int = 1) -> np.ndarray:
    """Check that masks differ from traced ones by ``most`` pixels at most; gives the traced ones."""
    traced = renderer.trace(poses, joints)
    wrong = (renderer.masks(poses, joints) != traced).sum(axis=(1, 2))
    assert wrong.max() <= most, wrong
    return traced


# Articulated instruments


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
def test_bundled_instrument_agrees_with_tracing(bundled_body: Body, kind, camera: str) -> None:
    rng = np.random.default_rng(sum(map(ord, kind.__name__ + camera)))
    assert_masks_are_traced(Renderer(bundled_body, CAMERAS[camera], threads=1), *kind(bundled_body, rng))


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", KINDS)
def test_open_mesh_agrees_with_tracing(scanned_body: Body, kind, camera: str) -> None:
    rng = np.random.default_rng(sum(map(ord, kind.__name__ + camera)) + 1)
    assert_masks_are_traced(Renderer(scanned_body, CAMERAS[camera], threads=1), *kind(scanned_body, rng))


@pytest.mark.parametrize("camera", FULL_SIZE)
def test_at_most_3_pixels_of_vga_differ(bundled_body: Body, scanned_body: Body, camera: str) -> None:
    for seed, body in enumerate((bundled_body, scanned_body)):
        rng = np.random.default_rng(seed + 40)
        renderer = Renderer(body, FULL_SIZE[camera], threads=1)
        for kind in (in_view, through_the_camera_plane):
            poses, joints = kind(body, rng)
            traced = assert_masks_are_traced(renderer, poses[:2], joints[:2], most=3)
            assert traced.any()


def test_instrument_behind_camera_is_invisible(bundled_body: Body) -> None:
    pose, joints = transform(np.eye(3), [0.0, 0.0, -0.05])[None], np.array([[0.1, 0.2, 0.3]])
    assert all((depth < NEAR).all() for depth in link_depths(bundled_body, pose[0], joints[0]))
    renderer = Renderer(bundled_body, CAMERAS["pinhole"])
    assert not renderer.masks(pose, joints).any()
    assert not renderer.trace(pose, joints).any()


# Meshes made by hand

FAN = surface([[0, 0, 0], [12, 0, 2], [8, 9, -2], [0, 12, 0], [-9, 8, 3]], [[0, 1, 2], [0, 2, 3], [0, 3, 4]])
TURNED_AGAINST_EACH_OTHER = surface([[0, 0, 0], [10, 0, 0], [3, 9, 0], [4, -8, 5]], [[0, 1, 2], [0, 1, 3]])
THREE_FACES_ON_AN_EDGE = surface(
    [[0, 0, -10], [0, 0, 10], [9, 1, 0], [-6, 7, 2], [-5, -8, -1]], [[0, 1, 2], [0, 1, 3], [1, 0, 4]]
)
FOUR_FACES_ON_AN_EDGE = surface(
    [[0, 0, -10], [0, 0, 10], [9, 1, 0], [-6, 7, 2], [-5, -8, -1], [6, -7, 1]],
    [[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5]],
)
CLOSED_BOX = trimesh.creation.box((0.012, 0.02, 0.03))
OPEN_BOX = trimesh.Trimesh(CLOSED_BOX.vertices, CLOSED_BOX.faces[2:], process=False)
INSIDE_OUT_BOX = trimesh.Trimesh(CLOSED_BOX.vertices, CLOSED_BOX.faces[:, ::-1], process=False)
ONE_FACE_TURNED = trimesh.Trimesh(
    CLOSED_BOX.vertices, np.r_[CLOSED_BOX.faces[:1, ::-1], CLOSED_BOX.faces[1:]], process=False
)
TWICE_THE_SAME = trimesh.Trimesh(CLOSED_BOX.vertices, np.r_[CLOSED_BOX.faces, CLOSED_BOX.faces], process=False)
BY_HAND = {
    "triangle fan": FAN,
    "two faces turned against each other": TURNED_AGAINST_EACH_OTHER,
    "three faces on an edge": THREE_FACES_ON_AN_EDGE,
    "four faces on an edge, all the same way": FOUR_FACES_ON_AN_EDGE,
    "box without a side": OPEN_BOX,
    "box inside out": INSIDE_OUT_BOX,
    "box with one face turned": ONE_FACE_TURNED,
    "box twice": TWICE_THE_SAME,
}


@pytest.fixture(scope="module")
def handmade() -> dict[str, Body]:
    return {name: Body.prepare(rigid_instrument(mesh)) for name, mesh in BY_HAND.items()}


def camera_is_in_a_face(mesh: trimesh.Trimesh, camera_from_link: np.ndarray) -> bool:
    """Tell whether the planes of two faces or more pass through the camera, whose pixels see these edge-on."""
    corners = apply(camera_from_link, mesh.vertices)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance = np.einsum("ij,ij->i", normals, corners[:, 0]) / np.linalg.norm(normals, axis=1)
    return bool((np.abs(distance) < 1e-9).sum() > 1)


@settings(max_examples=15)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.01, 0.12)),
    camera=st.sampled_from(sorted(CAMERAS)),
)
@pytest.mark.parametrize("name", BY_HAND)
def test_handmade_meshes_agree_with_tracing(
    handmade: dict[str, Body], name: str, turn: tuple, shift: tuple, camera: str
) -> None:
    """Rays may hit or miss a face that is seen exactly edge-on, so a few pixels may differ, but not all of them."""
    pose = transform(exp_rotation(turn), shift)[None]
    assume(not camera_is_in_a_face(BY_HAND[name], pose[0]))
    assert_masks_are_traced(Renderer(handmade[name], CAMERAS[camera], threads=1), pose, np.zeros((1, 0)), most=3)


@pytest.mark.parametrize("tilt", [-0.2, 0.0, 0.2])
def test_clipped_part_is_visible_in_wide_lens(tilt: float) -> None:
    """At the corners of this image, 84 degrees off the axis, the near plane is 10 mm from the eye."""
    wide = Camera(160, 120, 68, 68, 80, 60, (0.0, 0.0, 0.0, 0.0), "equidistant")
    plate = trimesh.creation.box((0.001, 0.03, 0.03))
    renderer = Renderer(Body.prepare(rigid_instrument(plate)), wide)
    pose = transform(exp_rotation([0.0, tilt, 0.0]), [-0.0034, 0.0, 0.005])[None]
    assert assert_masks_are_traced(renderer, pose, np.zeros((1, 0))).any()


def test_triangle_covers_pixel_centres_inside() -> None:
    corners = np.array([[20.3, 10.7], [130.2, 44.9], [61.7, 109.1]])
    camera = CAMERAS["pinhole"]
    points = np.c_[camera.normalise(corners), np.ones(3)] * 0.1
    triangle = trimesh.Trimesh(points, [[0, 1, 2]], process=False)
    renderer = Renderer(Body.prepare(rigid_instrument(triangle)), camera)
    v, u = np.mgrid[:120, :160]
    expected = np.ones((120, 160), dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        expected &= (b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0]) > 0
    assert 0.2 < expected.mean() < 0.4
    pose, none = np.eye(4)[None], np.zeros((1, 0))
    np.testing.assert_array_equal(renderer.trace(pose, none)[0], expected)
    np.testing.assert_array_equal(renderer.masks(pose, none)[0], expected)


# Cost and refused input


def test_pose_in_front_of_camera_needs_no_rays(bundled_body: Body, handmade: dict[str, Body]) -> None:
    joints = np.array([[0.3, -0.5, 0.8]])
    for camera in CAMERAS.values():
        renderer = Renderer(bundled_body, camera)
        renderer.masks(transform(exp_rotation([0.4, 0.5, 0.0]), [0.0, 0.0, 0.45])[None], joints)
        assert renderer.rays == 0
        for body in handmade.values():
            renderer = Renderer(body, camera)
            renderer.masks(transform(exp_rotation([0.4, 0.5, 0.0]), [0.0, 0.0, 0.1])[None], np.zeros((1, 0)))
            assert (renderer.rays, renderer.poses) == (0, 1)


def test_rescaled_renderer_gives_same_area(bundled_body: Body) -> None:
    full = Renderer(bundled_body, CAMERAS["pinhole"])
    small = full.at(80, 60)
    poses, joints = in_view(bundled_body, np.random.default_rng(12))
    assert small.camera == CAMERAS["pinhole"].scaled(80, 60)
    large_area, small_area = (r.masks(poses, joints).sum(axis=(1, 2)) for r in (full, small))
    np.testing.assert_allclose(4 * small_area, large_area, rtol=0.05, atol=40)


def test_missing_embree_is_reported(bundled_body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(DvrkCmaesError, match=r"^embreex is missing or does not load \(.*\): install it with 'pip"):
        Renderer(Body.prepare(bundled_body.instrument), CAMERAS["pinhole"]).trace(np.eye(4)[None], np.zeros((1, 3)))
