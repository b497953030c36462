"""Sums over silhouettes and antialiased coverage: compared with images, smooth in the pose, independent of threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from helpers.transforms import exp_rotation, moved, transform

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.silhouette import PixelSums

PINHOLE = Camera(160, 120, 220.7, 220.7, 110.9, 47.2)
LENS = Camera(160, 120, 206, 225, 99, 61, (-0.3517, 0.7089, 0.0044, -0.0008, -0.9176))


def population(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Give poses of a needle driver, most of them in view and some cut by the camera plane, and joints."""
    rng = np.random.default_rng(seed)
    shift = rng.uniform([-0.02, -0.02, 0.01], [0.02, 0.02, 0.15], (count, 3))
    return transform(exp_rotation(rng.uniform(-1, 1, (count, 3))), shift), rng.uniform(-0.3, 0.8, (count, 3))


def image_stack(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Give four random images (4, H, W), the first all ones, and weights (H, W) with a zero patch and zero pixels."""
    rng = np.random.default_rng(seed)
    images = np.concatenate([np.ones((1, 120, 160)), rng.uniform(-1, 3, (3, 120, 160))])
    weight = rng.integers(0, 2, (120, 160)).astype(float)
    weight[30:60, 40:90] = 0
    return images, weight


# Sums over images


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
@pytest.mark.parametrize("ignoring", [False, True])
def test_binary_sums_agree_with_masks(bundled_body: Body, camera: Camera, ignoring: bool) -> None:
    renderer = Renderer(bundled_body, camera, threads=1)
    images, weight = image_stack()
    table = PixelSums.of(images, weight if ignoring else None)
    masks = renderer.masks(*population(20))
    assert (masks.sum(axis=(1, 2)) > 100).sum() > 10
    expected = np.einsum("chw,khw->ck", masks, images * weight if ignoring else images)
    found = renderer.sums(*population(20), table, to_pixel=True)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-2)
    counted = renderer.sums(*population(20), PixelSums.of(images[:1]), to_pixel=True)
    np.testing.assert_array_equal(counted, masks.sum(axis=(1, 2))[:, None])
    whole = bundled_body.instrument
    root = replace(whole, links=whole.links[:1], link_joints=whole.link_joints[:1])
    both = [Renderer(Body(each), camera) for each in (whole, root)]
    found = both[0].sums(*population(20), table, to_pixel=True, part=(0, 1))
    np.testing.assert_array_equal(found, [each.sums(*population(20), table, to_pixel=True) for each in both])


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
@pytest.mark.parametrize("lines", [1, 2, 4])
def test_smooth_sums_agree_with_coverage(bundled_body: Body, camera: Camera, lines: int) -> None:
    renderer, (images, weight) = Renderer(bundled_body, camera, threads=1), image_stack()
    coverage = renderer.coverage(*population(20), lines_per_pixel=lines)
    assert coverage.dtype == np.float32
    assert -1e-6 <= coverage.min() <= coverage.max() <= 1 + 1e-6
    found = renderer.sums(*population(20), PixelSums.of(images, weight), lines_per_pixel=lines)
    np.testing.assert_allclose(found, np.einsum("chw,khw->ck", coverage, images * weight), rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize("lines", [1, 2, 4])
def test_coverage_agrees_with_supersampled_tracing(bundled_body: Body, lines: int) -> None:
    camera = PINHOLE.scaled(80, 60)
    poses, joints = population(3, seed=4)
    found = Renderer(bundled_body, camera).coverage(poses, joints, lines_per_pixel=lines)
    fine = Renderer(bundled_body, camera.scaled(640, 480)).trace(poses, joints).reshape(3, 60, 8, 80, 8)
    rows = {1: [3, 4], 2: [1, 2, 5, 6], 4: range(8)}[lines]  # the rows adjacent to each line
    expected = fine[:, :, rows].mean(axis=(2, 4))
    assert 0.02 < expected.mean() < 0.5
    assert np.abs(found - expected).mean() < 0.002
    assert np.quantile(np.abs(found - expected), 0.999) < 0.2


def test_more_lines_per_pixel_reduce_area_error(bundled_body: Body) -> None:
    """The shaft is nearly parallel to the rows, where single lines are least accurate."""
    renderer = Renderer(bundled_body, PINHOLE)
    turn = exp_rotation([0.0, 1.3, 0.0]) @ exp_rotation([0.0, 0.0, 0.3])
    poses = transform(exp_rotation(np.c_[np.zeros((40, 2)), np.linspace(-0.05, 0.05, 40)]) @ turn, [0.0, 0.005, 0.1])
    joints = np.tile([0.1, 0.2, 0.5], (40, 1))
    area = PixelSums.of(np.ones((1, 120, 160)))
    truth = renderer.sums(poses, joints, area, lines_per_pixel=32)[:, 0]
    error = [np.abs(renderer.sums(poses, joints, area, lines_per_pixel=n)[:, 0] - truth).mean() for n in (1, 2, 4)]
    assert error[0] > 1.5 * error[1] > 2 * error[2]
    binary = renderer.sums(poses, joints, area, to_pixel=True)[:, 0]
    assert np.abs(binary - truth).mean() > error[0]


# Continuity


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
@pytest.mark.parametrize("axis", range(6))
def test_smooth_sums_follow_small_steps(bundled_body: Body, camera: Camera, axis: int) -> None:
    """Steps are 5 um, 0.1 mrad, and 1 mrad about the shaft: hundredths of a pixel in the image."""
    renderer = Renderer(bundled_body, camera)
    pose = transform(exp_rotation([0.5, 0.4, 0.3]), [-0.005, 0.004, 0.11])
    change = np.zeros((65, 6))
    change[:, axis] = (np.arange(65) - 32) * [5e-6, 5e-6, 5e-6, 1e-4, 1e-4, 1e-3][axis]
    poses, joints = moved(pose, change), np.tile([0.3, -0.4, 0.7], (65, 1))
    area = PixelSums.of(np.ones((1, 120, 160)))

    def noise(values: np.ndarray) -> float:
        """Give the standard deviation about a smooth curve, in pixel areas."""
        steps = np.linspace(-1, 1, len(values))
        return float(np.std(values - np.polynomial.Polynomial.fit(steps, values, 2)(steps)))

    smooth, fine = (renderer.sums(poses, joints, area, lines_per_pixel=n)[:, 0] for n in (1, 4))
    binary = renderer.sums(poses, joints, area, to_pixel=True)[:, 0]
    assert noise(smooth) < 0.4
    assert noise(fine) < 0.2 * min(1.0, noise(binary))
    assert np.abs(np.diff(fine)).max() < 1.0


# Threads and groups


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
def test_results_do_not_depend_on_threads(bundled_body: Body, camera: Camera) -> None:
    poses, joints = population(43)
    table = PixelSums.of(*image_stack())
    results = []
    for threads in (1, 2, 3):
        renderer = Renderer(bundled_body, camera, threads=threads)
        smooth, binary = renderer.sums(poses, joints, table), renderer.sums(poses, joints, table, to_pixel=True)
        results.append((smooth, binary, renderer.coverage(poses, joints), renderer.masks(poses, joints)))
        assert renderer.poses == 4 * 43
    for result in results[1:]:
        for one, other in zip(results[0], result, strict=True):
            np.testing.assert_array_equal(one, other)


def test_renderer_is_thread_safe(bundled_body: Body) -> None:
    renderer = Renderer(bundled_body, PINHOLE, threads=2)
    table = PixelSums.of(*image_stack())
    populations = [population(20, seed) for seed in range(8)]
    expected = [(renderer.sums(*one, table), renderer.masks(*one)) for one in populations]
    poses = renderer.poses
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda one: (renderer.sums(*one, table), renderer.masks(*one)), populations))
    for (sums, masks), (sums_alone, masks_alone) in zip(found, expected, strict=True):
        np.testing.assert_array_equal(sums, sums_alone)
        np.testing.assert_array_equal(masks, masks_alone)
    assert renderer.poses == 2 * poses


def test_invisible_pose_has_zero_sums(bundled_body: Body) -> None:
    renderer = Renderer(bundled_body, PINHOLE)
    poses = transform(np.eye(3), [[5.0, 0.0, 0.1], [0.0, 0.0, -0.05], [0.0, -9.0, 0.2]])
    joints = np.zeros((3, 3))
    np.testing.assert_array_equal(renderer.sums(poses, joints, PixelSums.of(image_stack()[0])), np.zeros((3, 4)))
    assert not renderer.coverage(poses, joints).any()


# Masks of another renderer


def test_coverage_agrees_with_masks_of_other_renderer(scanned_body: Body, clean_frames) -> None:
    renderer = Renderer(scanned_body, clean_frames.camera)
    coverage = renderer.coverage(clean_frames.camera_from_root, clean_frames.joints)
    wrong = ((coverage > 0.5) != clean_frames.masks).sum(axis=(1, 2)) / clean_frames.masks.sum(axis=(1, 2))
    assert len(wrong) == 20
    assert wrong.mean() <= 0.001
    assert wrong.max() <= 0.003
