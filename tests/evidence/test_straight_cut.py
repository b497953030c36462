"""Detection of a mask that was cut off along a straight line, and no detection in complete masks."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.places import bundled_path
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, EstimateConfig, Renderer, estimate, read_frame, read_session
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence
from dvrk_cmaes.evidence.outline_noise import sampled, signed_distance
from dvrk_cmaes.evidence.straight_cut import largest_bend, shaft_width
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.judge import doubts_in_views
from dvrk_cmaes.pose.views import FrameView
from dvrk_cmaes.results.result import ExpectedError, Quality

CAMERA = Camera(640, 480, 880, 880, 330, 250)
POSE = lookat_pose(0.5, 1.0, 0.7, 0.11)
JOINTS = np.array([0.4, -0.3, 0.8])
WIDTH = 60.0


def bar(length: float = 200.0, width: float = WIDTH) -> np.ndarray:
    """Give the outline (N, 2) of a shaft that enters at the left border and ends in a straight transverse line."""
    along, across = np.arange(0.0, length), np.arange(0.0, width + 1)
    upper = np.stack([along, np.zeros_like(along)], axis=1)
    end = np.stack([np.full_like(across, length), across], axis=1)
    lower = np.stack([along[::-1], np.full_like(along, width)], axis=1)
    return np.concatenate([upper, end, lower])


def at_the_end(outline: np.ndarray) -> np.ndarray:
    return np.flatnonzero(outline[:, 0] == outline[:, 0].max())


def rounded_by(sagitta: float, outline: np.ndarray) -> np.ndarray:
    """Give an outline's distances from a silhouette whose end is round instead, with a sagitta in px."""
    distances, end = np.zeros(len(outline)), at_the_end(outline)
    from_middle = 2 * (outline[end, 1] - outline[end, 1].mean()) / np.ptp(outline[end, 1])
    distances[end] = -sagitta * (1 - from_middle**2)
    return distances


# how far a silhouette bends


def test_bend_along_cut_is_sagitta_of_round_end() -> None:
    outline = bar()
    assert largest_bend(outline, rounded_by(5.0, outline), WIDTH) == pytest.approx(5.0, abs=0.05)


@pytest.mark.parametrize("distance", [0.07, 0.11, 0.16])
def test_complete_mask_at_true_pose_has_no_bend(bundled_body: Body, distance: float) -> None:
    """Mask and silhouette have the same straight lines, so only the pixel grid's noise remains."""
    renderer = Renderer(bundled_body, CAMERA)
    for turn in np.linspace(-3, 3, 8):
        pose = lookat_pose(0.5, turn, 0.7, distance)
        mask = renderer.masks(pose[None], JOINTS[None])[0]
        outline = gather_evidence(mask, CAMERA, bundled_body.instrument).contour.pixels
        width = shaft_width(bundled_body.instrument, CAMERA, pose)
        assert width is not None
        assert largest_bend(outline, sampled(signed_distance(mask), outline), width) < 1.5


# width of the shaft


# reasons


@pytest.fixture
def evidence(bundled_body: Body) -> Evidence:
    return gather_evidence(
        Renderer(bundled_body, CAMERA).masks(POSE[None], JOINTS[None])[0], CAMERA, bundled_body.instrument
    )


def doubts(body: Body, evidence: Evidence, bend: float, distance: float = 0.11, *, followed: bool = False) -> list[str]:
    at = Posed(lookat_pose(0.5, 1.0, 0.7, distance), JOINTS)
    view = FrameView("", evidence, Renderer(body, CAMERA), np.eye(4))
    quality, error = Quality(0.99, 0.1, {}, 0.3, 0.9, bend), ExpectedError({"tip": 0.3}, {}, 0.5, 0.4)
    return doubts_in_views(at, [view], [quality], error, TrustConfig(), "followed" if followed else "alone")[0]


def test_reason_states_bend(bundled_body: Body, evidence: Evidence) -> None:
    assert doubts(bundled_body, evidence, 5.88) == [
        "mask cut straight: along a straight line that ends it, the silhouette bends by 5.9 px"
    ]


def test_neighbouring_images_allow_a_larger_bend(bundled_body: Body, evidence: Evidence) -> None:
    limit = next(bend for bend in np.arange(2.0, 8.0, 0.01) if doubts(bundled_body, evidence, bend))
    assert doubts(bundled_body, evidence, 1.45 * limit, followed=True) == []
    assert len(doubts(bundled_body, evidence, 1.55 * limit, followed=True)) == 1


# frames


@pytest.mark.parametrize("turn", [0, 45, 315])
def test_frame_with_half_mask_is_doubtful(bundled_body: Body, turn: float) -> None:
    session = read_session(bundled_path("demo"))
    files = session.frames[0]
    frame = read_frame(files, session.camera)
    rows, columns = np.indices(frame.mask.shape)
    middle, way = np.argwhere(frame.mask).mean(axis=0), np.deg2rad(turn)
    half = frame.mask & ((columns - middle[1]) * np.cos(way) + (rows - middle[0]) * np.sin(way) > 0)
    whole, cut = (
        estimate(mask, frame.camera, files.readings, bundled_body, config=EstimateConfig())
        for mask in (frame.mask, half)
    )
    assert whole.quality is not None
    assert cut.quality is not None
    assert whole.quality.bend_px < 2
    assert cut.quality.bend_px > 5
    assert not any(reason.startswith("mask cut straight") for reason in whole.reasons)
    assert any(reason.startswith("mask cut straight") for reason in cut.reasons)


@pytest.mark.parametrize("farther", [1.0, 1.5])
def test_shaft_width_is_distance_of_edges(bundled_body: Body, farther: float) -> None:
    pose = POSE.copy()
    pose[:3, 3] *= farther
    mask = Renderer(bundled_body, CAMERA).masks(pose[None], JOINTS[None])[0]
    edges = gather_evidence(mask, CAMERA, bundled_body.instrument).shaft_edges[0]
    root = CAMERA.project(pose[None, :3, 3])[0]
    lines = edges.planes @ np.linalg.inv(CAMERA.matrix)
    apart = -((lines[:, :2] @ root + lines[:, 2]) / np.linalg.norm(lines[:, :2], axis=1)).sum()
    assert shaft_width(bundled_body.instrument, CAMERA, pose) == pytest.approx(apart, rel=0.1)
