"""Instruments found in pictures by their model, on drawings whose colours the classic model does not know."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.transforms import transform

from dvrk_cmaes import Camera, Renderer, prepare
from dvrk_cmaes.geometry import Posed, frame_along, rotation_about_z
from dvrk_cmaes.segment import Segmentation, model_masks, segment
from dvrk_cmaes.segment.by_model import Candidate, find_instruments, rank
from dvrk_cmaes.segment.model_masks import segment_by_model
from dvrk_cmaes.segment.prompts import no_prompts
from dvrk_cmaes.segment.segmentation import GUESS

CAMERA = Camera(480, 384, 500.0, 500.0, 239.5, 191.5)
BODY = prepare("lnd")
LEFT = ((0.9, 0.25, 0.36), (-0.026, 0.0, 0.11), 0.4, (0.3, -0.2, 0.5))
RIGHT = ((-0.75, 0.6, 0.28), (0.030, -0.012, 0.12), 1.9, (-0.4, 0.3, 0.6))
Pose = tuple[tuple[float, ...], tuple[float, ...], float, tuple[float, ...]]


def posed(axis: tuple[float, ...], root: tuple[float, ...], roll: float, joints: tuple[float, ...]) -> Posed:
    direction = np.array(axis) / np.linalg.norm(axis)
    pose = transform(frame_along(direction) @ rotation_about_z(roll), np.array(root))
    return Posed(pose[None], np.array([joints]))


def drawn(*poses: Pose, seed: int = 0) -> tuple[np.ndarray, list[np.ndarray]]:
    """Draw instruments with brown shafts before orange foam and a grey plate; gives the image and their masks."""
    rng = np.random.default_rng(seed)
    image = np.full((CAMERA.height, CAMERA.width, 3), (90, 150, 220), np.float32)
    image[40:330, 170:330] = (140, 150, 145)
    masks = []
    for each in poses:
        at = posed(*each)
        mask = Renderer(BODY, CAMERA, threads=1).masks(at.pose, at.joints)[0]
        # wrist and jaws are beyond the root, bright and grained
        pixels = np.argwhere(mask)[:, ::-1].astype(float)
        start = CAMERA.project(at.pose[0, :3, 3])
        along = CAMERA.project(at.pose[0, :3, 3] + 1e-3 * at.pose[0, :3, 2]) - start
        distal = (pixels - start) @ along > -5 * np.hypot(*along) ** 2
        image[mask] = (40, 60, 85)
        v, u = pixels[distal].astype(int).T[::-1]
        image[v, u] = (190, 195, 200) + 25 * rng.standard_normal((len(u), 1))
        masks.append(mask)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + 4 * rng.standard_normal(image.shape)
    return np.clip(image, 0, 255).astype(np.uint8), masks


def overlap(found: np.ndarray, mask: np.ndarray) -> float:
    return float((found & mask).sum() / (found | mask).sum())


@pytest.fixture(scope="module")
def two() -> tuple[np.ndarray, list[np.ndarray], Segmentation]:
    image, masks = drawn(LEFT, RIGHT)
    return image, masks, segment(image, instrument=BODY, camera=CAMERA)


def test_each_of_two_instruments_has_a_mask(two: tuple[np.ndarray, list[np.ndarray], Segmentation]) -> None:
    _, masks, found = two
    assert len(found.others) == 1
    both = [found.mask, found.others[0].mask]
    assert not (both[0] & both[1]).any()
    for mask in masks:
        assert max(overlap(each, mask) for each in both) > 0.85
    assert min(found.confidence, found.others[0].confidence) >= GUESS


def test_the_one_that_is_taken_is_named(two: tuple[np.ndarray, list[np.ndarray], Segmentation]) -> None:
    _, masks, found = two
    side = "left" if overlap(found.mask, masks[0]) > 0.5 else "right"
    assert f"two instruments, the {side} one taken (pass --point)" in found.notes


def test_a_point_or_an_expected_pose_chooses(two: tuple[np.ndarray, list[np.ndarray], Segmentation]) -> None:
    image, masks, _ = two
    for mask, pose in zip(masks, (LEFT, RIGHT), strict=True):
        inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
        v, u = np.unravel_index(int(inside.argmax()), mask.shape)
        found = segment(image, instrument=BODY, camera=CAMERA, points=[(float(u), float(v))])
        assert overlap(found.mask, mask) > 0.85
        assert found.others == ()
        off = posed(*pose)[0].moved(np.array([0.004, 0.004, 0.008, 0.1, 0.1, 0.3, 0.1, 0.1, 0.1]))
        assert overlap(segment(image, instrument=BODY, camera=CAMERA, expected=off).mask, mask) > 0.85


def test_candidates_are_where_the_instruments_are_and_share_few_pixels() -> None:
    image, masks = drawn(RIGHT, seed=3)
    found = find_instruments(image, no_prompts(image.shape), BODY, CAMERA)
    size = found[0].silhouette.shape[::-1]
    small = cv2.resize(masks[0].astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    assert overlap(found[0].silhouette, small) > 0.75
    axis = np.array(RIGHT[0]) / np.linalg.norm(RIGHT[0])
    assert np.degrees(np.arccos(found[0].at.pose[:3, 2] @ axis)) < 8
    assert found == sorted(found, key=lambda each: -rank(each.score, each.confidence))
    again = find_instruments(image, no_prompts(image.shape), BODY, CAMERA)
    assert np.array_equal(again[0].at.pose, found[0].at.pose)


def test_a_mask_by_other_means_of_both_instruments_is_divided(
    two: tuple[np.ndarray, list[np.ndarray], Segmentation], monkeypatch: pytest.MonkeyPatch
) -> None:
    image, masks, _ = two
    monkeypatch.setattr(model_masks, "SAME", 0.3)
    both = Segmentation(masks[0] | masks[1], confidence=0.99)
    found = segment_by_model(image, BODY, CAMERA, None, no_prompts(image.shape), lambda: both, lambda: both)
    assert found.confidence == 0.99
    assert len(found.others) == 1
    for mask in masks:
        assert max(overlap(each, mask) for each in (found.mask, found.others[0].mask)) > 0.8


def behind_a_flap() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an image of an instrument that a flap hides in part, its mask without the flap, and the flap (H, W)."""
    image, masks = drawn(LEFT)
    flap = np.zeros_like(masks[0])
    flap[:, 90:125] = True
    noise = 4 * np.random.default_rng(1).standard_normal((int(flap.sum()), 3))
    image[flap] = np.clip(np.array([90, 150, 220]) + noise, 0, 255)
    return image, masks[0], flap


def test_another_mask_is_taken_that_is_of_the_same_instrument_and_surer(monkeypatch: pytest.MonkeyPatch) -> None:
    image, mask, _ = behind_a_flap()
    monkeypatch.setattr(model_masks, "mask_of_candidate", lambda *_: Segmentation(mask, confidence=0.4))
    part = mask.copy()
    part[:, 125:] = False
    for shown, confidence, taken in [
        (drawn(RIGHT)[1][0], 0.9, False),
        (part, 0.9, False),
        (mask, 0.9, True),
        (mask, 0.1, False),
    ]:
        other = Segmentation(shown, confidence=confidence)
        found = segment_by_model(image, BODY, CAMERA, None, no_prompts(image.shape), *2 * [lambda other=other: other])
        assert (found is other) == taken


@pytest.mark.parametrize(("confidence", "taken"), [(0.4, True), (0.1, False)])
def test_an_unlikely_instrument_is_a_guess_where_nothing_else_is_found(
    confidence: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, (mask,) = drawn(LEFT)
    candidate = find_instruments(image, no_prompts(image.shape), BODY, CAMERA)[0]
    unlikely = replace(candidate, confidence=confidence - 0.01)
    monkeypatch.setattr(model_masks, "find_instruments", lambda *_, **__: [unlikely])
    nothing = Segmentation(np.zeros_like(mask), confidence=0.0)
    found = segment_by_model(image, BODY, CAMERA, None, no_prompts(image.shape), lambda: nothing, lambda: nothing)
    assert (found is not nothing) == taken
    assert found.confidence < GUESS
    if taken:
        assert overlap(found.mask, mask) > 0.9


def test_a_guess_is_taken_before_a_surer_instrument_only_of_a_clearly_larger_score(
    two: tuple[np.ndarray, list[np.ndarray], Segmentation], monkeypatch: pytest.MonkeyPatch
) -> None:
    image, masks, _ = two
    found = [Candidate(posed(*pose)[0], 6.0, 0.6, mask) for pose, mask in zip((LEFT, RIGHT), masks, strict=True)]
    nothing = Segmentation(np.zeros_like(masks[0]), confidence=0.0)
    for score, first in [(7.5, 0), (6.5, 1)]:
        guess = replace(found[0], score=score, confidence=0.45)
        both = sorted([guess, found[1]], key=lambda each: -rank(each.score, each.confidence))
        monkeypatch.setattr(model_masks, "find_instruments", lambda *_, both=both, **__: both)
        taken = segment_by_model(image, BODY, CAMERA, None, no_prompts(image.shape), *2 * [lambda: nothing])
        assert overlap(taken.mask, masks[first]) > 0.8
        assert (taken.confidence < GUESS) == (first == 0)


def test_what_lies_before_an_instrument_is_not_in_its_mask() -> None:
    image, mask, flap = behind_a_flap()
    found = segment(image, instrument=BODY, camera=CAMERA)
    assert overlap(found.mask & ~flap, mask & ~flap) > 0.8
    assert found.mask[flap & mask].mean() < 0.2


def test_a_plate_is_no_instrument() -> None:
    image, _ = drawn(seed=5)
    found = segment(image, instrument=BODY, camera=CAMERA)
    assert found.confidence < GUESS
    assert found.others == ()


def test_a_picture_without_edges_has_no_candidates() -> None:
    image = np.full((120, 160, 3), 90, np.uint8)
    assert find_instruments(image, no_prompts(image.shape), BODY, CAMERA.scaled(160, 120)) == []
