"""The rotation of the right eye against the rig's file: estimated from a session's frames, and used."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory
from helpers.transforms import rotation_angle, transform

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    Renderer,
    Rig,
    SessionFrame,
    SolvedSession,
    calibrate_session,
    estimate,
)
from dvrk_cmaes.camera.rig_files import read_rig
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.runs.calibrate_folder import write_cameras

pytestmark = pytest.mark.usefixtures("searches_short")

RIGHT_FROM_LEFT = transform(np.eye(3), [-0.0053, 0.0, 0.0])
RIG = Rig.stereo(SMALL, SMALL, RIGHT_FROM_LEFT)
TURN = np.array([0.3, 0.0, 0.0])  # deg
FILE = Rig((RIG.views[0], RIG.views[1].turned(-np.deg2rad(TURN))))  # what the file says of a right eye that is turned
SETTINGS = EstimateConfig(session=SessionConfig(test_camera=False))


@pytest.fixture(scope="module")
def frames_of(bundled_body: Body) -> dict[str, list[SessionFrame]]:
    """Frames that both eyes saw, with results by the right file and by one whose right eye is turned."""
    _, truths, frames = make_frames_in_memory(bundled_body, 5, level="clean")
    found: dict[str, list[SessionFrame]] = {"right": [], "turned": []}
    for frame, truth in zip(frames, truths, strict=True):
        assert isinstance(frame.data, FrameData)
        there = Renderer(bundled_body, SMALL).masks(
            (RIGHT_FROM_LEFT @ truth.camera_from_root)[None], truth.values[None]
        )
        masks = {"left": frame.data.mask, "right": there[0]}
        for kind, rig in (("right", RIG), ("turned", FILE)):
            result = replace(estimate(masks, rig, frame.result.readings, bundled_body), frame=frame.name)
            found[kind].append(replace(frame, data=FrameData.of(masks, rig), result=result))
    return found


@pytest.fixture(scope="module")
def turned(bundled_body: Body, frames_of: dict[str, list[SessionFrame]]) -> SolvedSession:
    return calibrate_session(frames_of["turned"], bundled_body, config=SETTINGS)


@pytest.fixture(scope="module")
def by_right(bundled_body: Body, frames_of: dict[str, list[SessionFrame]]) -> SolvedSession:
    return calibrate_session(frames_of["right"], bundled_body, config=SETTINGS)


def test_rotation_is_found_with_its_error(turned: SolvedSession) -> None:
    rotation = turned.calibration.blocks["rig right"]
    assert rotation.applied
    assert rotation.text.endswith("against the file, in 5 frames")
    assert (np.abs(np.degrees(rotation.values) - TURN) < 2.5 * np.degrees(rotation.std)).all()
    assert np.degrees(rotation.std[0]) < 0.05


def test_right_file_is_left_as_it_is(by_right: SolvedSession) -> None:
    calibration = by_right.calibration
    assert not calibration.blocks["rig right"].applied
    assert not any("eye" in text for text in calibration.warnings)
    assert calibration.blocks["rig right"].text.startswith("the right eye is as in the file: ")
    right = calibration.corrected_views(RIG.views)[1]
    np.testing.assert_array_equal(right.view_from_camera, RIG.views[1].view_from_camera)


def test_new_frame_is_seen_with_the_turned_eye(
    bundled_body: Body, frames_of: dict[str, list[SessionFrame]], turned: SolvedSession
) -> None:
    _, right = turned.calibration.corrected_views(FILE.views)
    assert np.degrees(rotation_angle(right.view_from_camera, RIGHT_FROM_LEFT)) < 0.1
    frame = frames_of["turned"][0]
    assert isinstance(frame.data, FrameData)
    masks = {view.name: view.mask for view in frame.data.views}
    found = estimate(masks, FILE, frame.result.readings, bundled_body, session=turned.calibration, config=SETTINGS)
    assert found.source == "session"
    assert found.quality is not None
    assert found.quality.iou > 0.95


def test_exchanged_eyes_are_named(bundled_body: Body, frames_of: dict[str, list[SessionFrame]]) -> None:
    """None is ok; which of the wrong poses is found, and so whether the other side fits it, is chance."""
    named = 0
    for frame, seed in product(frames_of["right"][:3], (0, 2)):
        assert isinstance(frame.data, FrameData)
        left, right = (view.mask for view in frame.data.views)
        masks, config = {"left": right, "right": left}, EstimateConfig(seed=seed)
        found = estimate(masks, RIG, frame.result.readings, bundled_body, config=config)
        assert found.status == "doubtful"
        named += found.reasons[0].startswith("views disagree: right fits left only from its other side: the ")
        assert not any("other side" in text for text in frame.result.reasons)
    assert named >= 3


def test_rig_that_was_used_is_written_in_a_format_that_is_read(turned: SolvedSession, tmp_path: Path) -> None:
    write_cameras(turned.calibration, FILE, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["left.yaml", "right.yaml"]
    rig = read_rig(tmp_path / "left.yaml", tmp_path / "right.yaml").rig
    for found, used in zip(rig.views, turned.calibration.corrected_views(FILE.views), strict=True):
        np.testing.assert_allclose(found.camera.matrix, used.camera.matrix)
        np.testing.assert_allclose(found.view_from_camera, used.view_from_camera, atol=1e-9)
