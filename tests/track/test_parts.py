"""Parts of the filter: readings, edges of masks, derivatives of the outline and of the pose, smoothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.moving_worlds import SMALL

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig, TrackConfig
from dvrk_cmaes.geometry import Posed, moved
from dvrk_cmaes.joints.names import OUTER_JOINTS
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.track.drawn_outline import DrawnOutline
from dvrk_cmaes.track.mask_evidence import MaskEvidence
from dvrk_cmaes.track.motion import Anchor, MotionModel
from dvrk_cmaes.track.outline_model import OutlineModel
from dvrk_cmaes.track.reading_buffer import ReadingBuffer
from dvrk_cmaes.track.smoother import FilterStep, smoothed_states
from dvrk_cmaes.track.start import placed, unknown_state
from dvrk_cmaes.track.state import FilterState, Layout

NAMES = ("wrist_pitch", "wrist_yaw", "jaw")
ANCHOR = Anchor(
    np.array([0.1, -0.2, 0.15, 0.5]),
    np.array([0.2, 0.1, 0.6]),
    np.zeros(4),
    np.zeros(3),
    True,
    np.ones(3, np.bool_),
    True,
)
POSE = moved(np.eye(4), [0.01, 0.005, 0.12, 0.6, 0.4, -0.3])
MOTION = MotionModel(TrackConfig(), 3, "classic", 0.4162)


def some_state() -> FilterState:
    blank = unknown_state(EstimateConfig(), MOTION, ANCHOR, NAMES, 0.0)
    return placed(blank, MOTION, ANCHOR, Posed(POSE, np.array([0.3, 0.0, 0.7])), 1e-6 * np.eye(9))


# readings


def test_readings_are_interpolated_and_forgotten() -> None:
    buffer = ReadingBuffer(NAMES, gap=0.15, still=0.25)
    for k in range(20_000):
        buffer.add(k / 100, {"yaw": k / 10_000, "jaw": 0.5})
    at = buffer.at(199.905)
    assert at.outer[0] == pytest.approx(1.99905)
    assert at.outer_rate[0] == pytest.approx(1 / 100)
    assert np.isnan(at.outer[1])
    assert at.joints[2] == 0.5
    assert np.isnan(buffer.at(1.0).outer[0])
    assert np.isnan(buffer.at(201.0).outer[0])


def test_jaw_of_its_own_topic_is_interpolated_between_its_own_readings() -> None:
    buffer = ReadingBuffer(NAMES, gap=0.15, still=0.25)
    for k in range(100):
        arm = dict.fromkeys(("yaw", "pitch", "roll", "insertion", *NAMES[:2]), k / 1000)
        buffer.add(k / 100, arm)
        buffer.add(k / 100 + 0.004, {"jaw": k / 500})
    at = buffer.at(0.507)
    assert np.allclose(at.outer, 0.0507)
    assert np.allclose(at.joints, [0.0507, 0.0507, 0.1006])
    assert np.allclose([at.outer_rate[0], at.joint_rate[2]], [0.1, 0.2])
    assert np.allclose(buffer.outer_at(np.array([0.203, 0.507])), [[0.0203] * 4, [0.0507] * 4])
    assert not at.still


def test_frozen_readings_are_noticed() -> None:
    buffer = ReadingBuffer(NAMES, gap=0.15, still=0.25)
    for k in range(60):
        buffer.add(k / 30, dict.fromkeys(("yaw", "pitch", "roll"), min(k, 30) / 100) | {"insertion": 0.1})
    assert not buffer.at(0.9).still
    assert buffer.at(1.9).still


# edges of a mask


def outline_at(pixels: np.ndarray, normals: np.ndarray) -> DrawnOutline:
    """Give an outline at some pixels of the only view."""
    count = len(pixels)
    return DrawnOutline(
        views=(0,),
        at=Posed(np.eye(4), np.zeros(3)),
        parts={0: slice(None)},
        all_pixels={0: pixels},
        link=np.zeros(count, np.intp),
        points=np.zeros((count, 3)),
        normals=normals,
        lengths=np.ones(count),
        pixels=pixels,
    )


def test_distance_from_edge_of_mask_is_found_below_a_pixel() -> None:
    mask = np.zeros((100, 120), np.bool_)
    mask[:, 40:80] = True  # edges at 39.5 and 79.5
    pixels = np.array([[79.5, 50.0], [81.25, 50.0], [77.0, 20.0], [39.5, 30.0], [95.0, 50.0]])
    normals = np.array([[1.0, 0], [1, 0], [1, 0], [-1, 0], [1, 0]])
    found = MaskEvidence(mask).distances(pixels, outline_at(pixels, normals), 8.0)
    assert found.found.tolist() == [True, True, True, True, False]
    assert np.allclose(found.distance[:4], [0, 1.75, -2.5, 0], atol=0.06)


def test_edge_that_faces_another_way_does_not_count() -> None:
    mask = np.zeros((60, 60), np.bool_)
    mask[:, 30:] = True
    pixels = np.array([[30.0, 30.0]])
    assert not MaskEvidence(mask).distances(pixels, outline_at(pixels, np.array([[1.0, 0.0]])), 8.0).found[0]


def test_ignored_pixels_have_no_edges() -> None:
    mask, ignore = np.zeros((60, 60), np.bool_), np.zeros((60, 60), np.bool_)
    mask[:, 10:40], ignore[:, 35:45] = True, True
    evidence = MaskEvidence(mask, ignore)
    pixels = np.array([[36.0, 30.0], [9.5, 30.0]])
    found = evidence.distances(pixels, outline_at(pixels, np.array([[1.0, 0.0], [-1.0, 0.0]])), 8.0)
    assert found.found.tolist() == [False, True]


def test_share_of_edge_without_outline() -> None:
    mask = np.zeros((100, 100), np.bool_)
    mask[:, 30:70] = True
    left = np.stack([np.full(100, 30.0), np.arange(100.0)], axis=1)
    outline = outline_at(left, np.tile([-1.0, 0.0], (100, 1)))
    assert MaskEvidence(mask).unexplained(left, outline, 6) == pytest.approx(0.5, abs=0.02)


# derivatives


def test_jacobian_of_outline_agrees_with_differences() -> None:
    model, at = OutlineModel(prepare("lnd"), Rig.of(SMALL), 100), Posed(POSE, np.array([0.3, 0.2, 0.7]))
    outline = model.draw(at, (0,))
    assert outline is not None
    here = model.move(outline, at)
    assert here is not None
    step = 1e-6
    for k in range(9):
        change = np.zeros(9)
        change[k] = step
        there = model.place(outline, at.moved(change))
        assert there is not None
        along = ((there - here.pixels) * outline.normals).sum(axis=1) / step
        assert np.allclose(along, here.jacobian[:, k], rtol=1e-3, atol=1e-2 * np.abs(here.jacobian[:, k]).max() + 1e-3)


def test_loadings_agree_with_differences() -> None:
    state, step = some_state(), 1e-6
    at = MOTION.posed(state, ANCHOR)
    loadings = MOTION.loadings(state, ANCHOR)
    for k in range(Layout(3).size):
        change = np.zeros(Layout(3).size)
        change[k] = step
        there = MOTION.posed(state.changed(change), ANCHOR)
        assert np.allclose(there.minus(at) / step, loadings[:, k], atol=1e-5)


def test_placed_state_has_the_given_pose() -> None:
    at = MOTION.posed(some_state(), ANCHOR)
    assert np.allclose(at.pose, POSE)
    assert np.allclose(at.joints, [0.3, 0.0, 0.7])


def test_difference_is_what_changes_a_state_into_another() -> None:
    state = some_state()
    change = 1e-3 * np.arange(Layout(3).size)
    assert np.allclose(state.difference(state.changed(change)), change, atol=1e-12)


# smoothing


def test_smoothing_without_later_evidence_changes_nothing() -> None:
    state = some_state()
    steps = [FilterStep(None, None, state, ANCHOR)]
    for _ in range(4):
        prior, transition = MOTION.predict(steps[-1].posterior, ANCHOR, ANCHOR, 1 / 30, 0.0)
        steps.append(FilterStep(prior, transition, prior, ANCHOR))
    for before, after in zip(steps, smoothed_states(steps), strict=True):
        assert np.abs(before.posterior.difference(after)).max() < 1e-9
        assert np.allclose(before.posterior.covariance, after.covariance, rtol=1e-4, atol=1e-9)


def test_later_knowledge_of_an_offset_reaches_earlier_images() -> None:
    state, at = some_state(), Layout(3)
    prior, transition = MOTION.predict(state, ANCHOR, ANCHOR, 1 / 30, 0.0)
    change = np.zeros(at.size)
    change[at.offsets.start] = 0.01
    known = replace(prior.changed(change), covariance=prior.covariance * 0.5)
    first, _ = smoothed_states([FilterStep(None, None, state, ANCHOR), FilterStep(prior, transition, known, ANCHOR)])
    assert 0.001 < first.offsets[1] - state.offsets[1] < 0.01
    assert first.covariance[at.offsets.start, at.offsets.start] < state.covariance[at.offsets.start, at.offsets.start]


@pytest.mark.parametrize("jaw_first", [False, True])
def test_readings_of_arm_and_jaw_at_the_same_times_are_all_kept(*, jaw_first: bool) -> None:
    buffer = ReadingBuffer(NAMES, gap=0.15, still=0.25)
    for k in range(5):
        arm = dict.fromkeys((*OUTER_JOINTS, *NAMES[:-1]), 0.1 * k)
        for joints in ({NAMES[-1]: 0.2}, arm) if jaw_first else (arm, {NAMES[-1]: 0.2}):
            buffer.add(k / 10, joints)
    read = buffer.at(0.25)
    assert read.outer == pytest.approx([0.25] * 4)
    assert read.joints == pytest.approx([*[0.25] * (len(NAMES) - 1), 0.2])
