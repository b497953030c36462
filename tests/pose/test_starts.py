"""Start poses of the search: LookAt poses, free or on the axis given by two shaft edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig, LookAtRange
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose.search.starts import (
    draw_starts,
    likely_distances,
    lookat_pose,
    sample_distances,
    sample_joints,
    sample_lookat,
    sample_on_axis,
)
from dvrk_cmaes.silhouette import Body, Renderer

CAMERA = Camera(640, 480, 858.9, 934.9, 422.9, 284.2, (-0.2484, 0.2681, 0.0048, -0.0033))
LIMITS = LookAtRange()
DIRECTION = np.array([0.6, -0.48, 0.64])
POINT = np.array([0.01, 0.02, 0.12])


def on_axis(count: int = 200, tilt: float = 0.0, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return sample_on_axis(count, DIRECTION, POINT, (-0.02, 0.03), tilt, rng, pivot=-0.04)


def lookat(count: int, seed: int, *, camera: Camera = CAMERA, pixels: np.ndarray | None = None) -> np.ndarray:
    mask = None if pixels is None else mask_of(pixels, camera)
    rng = np.random.default_rng(seed)
    return sample_lookat(sample_distances(count, LIMITS, None, rng), LIMITS, rng, camera=camera, mask=mask)


def mask_of(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    mask = np.zeros((camera.height, camera.width), dtype=np.bool_)
    mask[pixels[:, 1].astype(int), pixels[:, 0].astype(int)] = True
    return mask


def assert_rigid(poses: np.ndarray) -> None:
    np.testing.assert_allclose(inverse(poses) @ poses, np.broadcast_to(np.eye(4), poses.shape), atol=1e-12)
    assert (np.linalg.det(poses[:, :3, :3]) > 0).all()


@given(*[st.floats(-7, 7)] * 3, st.floats(0.01, 1))
def test_lookat_pose_is_rotation_about_z_x_y(alpha: float, beta: float, gamma: float, distance: float) -> None:
    pose = lookat_pose(alpha, beta, gamma, distance)
    turns = [Rotation.from_rotvec(v).as_matrix() for v in ([0, gamma, 0], [alpha, 0, 0], [0, 0, beta])]
    expected = turns[0] @ turns[1] @ turns[2]
    np.testing.assert_allclose(pose[:3, :3], expected, atol=1e-12)
    np.testing.assert_array_equal(pose[:3, 3], [0, 0, distance])


@pytest.mark.parametrize("likely", [(0.1, 0.2), (0.01, 0.1), (0.3, 4.0)])
def test_most_distances_are_likely_and_the_others_fill_the_limits(likely: tuple[float, float]) -> None:
    distances = sample_distances(4000, LIMITS, np.array(likely), np.random.default_rng(0))
    assert LIMITS.near <= distances.min() < 1.02 * LIMITS.near
    assert 0.98 * LIMITS.far < distances.max() <= LIMITS.far
    inside = (distances >= likely[0]) & (distances <= likely[1])
    assert inside.mean() > 0.75
    assert (~inside).mean() > 0.1


@pytest.mark.parametrize("distance", [0.04, 0.07, 0.12, 0.2, 0.3, 0.4])
@pytest.mark.parametrize("turn", [0.0, 2.0, 4.0])
def test_width_of_mask_tells_the_distance(bundled_body: Body, distance: float, turn: float) -> None:
    camera = Camera(640, 480, 900.0, 900.0, 320.0, 240.0)
    pose, joints = lookat_pose(0.9, turn, 0.3, distance)[None], np.array([[0.3, -0.2, 0.6]])
    mask = Renderer(bundled_body, camera, threads=1).masks(pose, joints)[0]
    evidence = gather_evidence(mask, camera, bundled_body.instrument, features=False)
    likely = likely_distances(evidence, bundled_body.instrument)
    assert likely is not None
    assert likely[0] < distance < likely[1]


def test_lookat_samples_at_pixels_project_to_them() -> None:
    pixels = np.array([[12.0, 34.0], [600.0, 20.0], [300.0, 460.0]])
    poses = lookat(300, 2, pixels=pixels)
    assert_rigid(poses)
    distance = np.linalg.norm(poses[:, :3, 3], axis=1)
    assert (distance > LIMITS.near).all()
    assert (distance < LIMITS.far).all()
    away = np.linalg.norm(CAMERA.project(poses[:, :3, 3])[:, None] - pixels, axis=2)
    assert away.min(axis=1).max() < 1e-6
    assert set(away.argmin(axis=1)) == {0, 1, 2}


def test_samples_on_axis_keep_shaft_on_axis() -> None:
    poses = on_axis()
    assert_rigid(poses)
    np.testing.assert_allclose(poses[:, :3, 2], np.broadcast_to(DIRECTION, (200, 3)), atol=1e-12)
    along = (poses[:, :3, 3] - POINT) @ DIRECTION
    np.testing.assert_allclose(poses[:, :3, 3], POINT + along[:, None] * DIRECTION, atol=1e-12)
    assert -0.02 <= along.min() < -0.018
    assert 0.028 < along.max() <= 0.03


def test_joint_samples_follow_readings_within_limits(bundled_body: Body) -> None:
    instrument = bundled_body.instrument
    low, high = instrument.limits.T
    readings, spread = np.array([0.2, np.nan, high[2] - 0.01]), np.array([0.1, 0.1, 0.2])
    unread = np.arange(6000) >= 4000
    joints, free = np.split(
        sample_joints(Readings(readings, spread, low, high), unread, np.random.default_rng(5)), [4000]
    )
    assert np.ptp(free, axis=0) == pytest.approx(high - low, rel=0.02)
    assert joints.shape == (4000, 3)
    assert (joints >= low).all()
    assert (joints <= high).all()
    assert joints[:, 0].mean() == pytest.approx(0.2, abs=0.01)
    assert joints[:, 0].std() == pytest.approx(0.1, rel=0.1)
    unknown = (joints[:, 1] - low[1]) / (high[1] - low[1])
    np.testing.assert_allclose(np.quantile(unknown, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)
    assert (joints[:, 2] == high[2]).mean() == pytest.approx(0.48, abs=0.05)


@pytest.mark.parametrize("name", ["lookat", "axis", "joints"])
def test_samples_depend_on_seed(name: str) -> None:
    def draw(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        if name == "lookat":
            return lookat(8, seed, pixels=np.array([[1.0, 2.0], [300, 200]]))
        if name == "axis":
            return on_axis(8, tilt=0.1, seed=seed)
        readings = Readings(np.array([0.1, np.nan, 0.2]), np.full(3, 0.1), np.full(3, -1.0), np.ones(3))
        return sample_joints(readings, np.zeros(8, dtype=np.bool_), rng)

    np.testing.assert_array_equal(draw(1), draw(1))
    assert not np.array_equal(draw(1), draw(2))


@pytest.mark.parametrize(("cut", "ends"), [(0, 1), (30, 2)])
def test_candidates_are_at_either_end_where_it_is_not_seen_which_one_is_distal(
    bundled_body: Body, cut: int, ends: int
) -> None:
    camera = Camera(640, 480, 900.0, 900.0, 320.0, 240.0)
    pose, joints = lookat_pose(0.9, 1.0, 0.3, 0.12), np.array([[0.3, -0.2, 0.6]])
    mask = Renderer(bundled_body, camera, threads=1).masks(pose[None], joints)[0]
    v, u = np.mgrid[:480, :640]
    mask &= (u >= cut) & (u < 640 - cut) & (v >= cut) & (v < 480 - cut)
    evidence = gather_evidence(mask, camera, bundled_body.instrument)
    config = EstimateConfig()
    config = replace(config, search=replace(config.search, free_share=0.0))
    readings = Readings.none(bundled_body.instrument)
    drawn, _ = draw_starts(evidence, bundled_body.instrument, readings, config, np.random.default_rng(0))
    along = drawn.pose[:, :3, 2] @ pose[:3, 2]
    assert len(np.unique(np.sign(along))) == ends
    assert (along > 0).mean() >= 0.5 if ends == 2 else (along > 0).all()
