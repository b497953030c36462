"""Baseline and focal length of the right eye against the rig's file: told by a session's frames, and used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes.calibration.calibrate import SolvedSession, calibrate_session
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.calibration.session_rig import ViewRotation, ViewScale
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.camera.rig import ViewChange
from dvrk_cmaes.camera.rig_files import read_rig
from dvrk_cmaes.config import EstimateConfig, SessionConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import transform
from dvrk_cmaes.results.parts import Quality, ViewCheck
from dvrk_cmaes.runs.calibrate_folder import write_cameras
from dvrk_cmaes.silhouette import Body, Renderer

RIG = Rig.stereo(SMALL, SMALL, transform(np.eye(3), [-0.0053, 0.0, 0.0]))
TRUE = {"right": (1.0, 1.0), "baseline": (1.05, 1.0), "focal": (1.0, 0.97)}
"""Factors from the file's baseline and focal length of the right eye to the true ones, by case."""
SETTINGS = EstimateConfig(session=SessionConfig(rounds=2))
COUNT = 8


def file_of(case: str) -> Rig:
    """What the rig's file says of the right eye."""
    baseline, focal = (-float(np.log(factor)) for factor in TRUE[case])
    return Rig((RIG.views[0], RIG.views[1].changed(ViewChange(np.zeros(3), baseline, focal))))


def frame_of(frame: SessionFrame, masks: dict[str, np.ndarray], rig: Rig) -> SessionFrame:
    """A frame of both eyes with a rig's file, whose own result does not tell a rotation of the right one."""
    covariance = np.diag([0.05, 0.2, 0.1]) ** 2
    quality = Quality(0.95, 0.1, {}, 0.8, 2.0)
    checks = tuple(ViewCheck(name, quality, np.zeros(3), covariance) for name in rig.names)
    return replace(frame, data=FrameData.of(masks, rig), result=replace(frame.result, view_fits=checks))


@pytest.fixture(scope="module")
def frames_of(bundled_body: Body) -> dict[str, list[SessionFrame]]:
    """The same frames with right and wrong files."""
    _, truths, frames = make_frames_in_memory(bundled_body, COUNT, level="clean", seed=21)
    right, found = RIG.views[1].view_from_camera, {case: [] for case in TRUE}
    for frame, truth in zip(frames, truths, strict=True):
        assert isinstance(frame.data, FrameData)
        there = Renderer(bundled_body, SMALL).masks((right @ truth.camera_from_root)[None], truth.values[None])
        for case, own in found.items():
            own.append(frame_of(frame, {"left": frame.data.mask, "right": there[0]}, file_of(case)))
    return found


@pytest.fixture(scope="module")
def solved(bundled_body: Body, frames_of: dict[str, list[SessionFrame]]) -> dict[str, SolvedSession]:
    return {case: calibrate_session(frames, bundled_body, config=SETTINGS) for case, frames in frames_of.items()}


@pytest.mark.parametrize("case", TRUE)
def test_scales_are_found_with_their_errors(case: str, solved: dict[str, SolvedSession]) -> None:
    (view,) = solved[case].calibration.rig
    for found, true in zip((view.baseline, view.focal_length), TRUE[case], strict=True):
        assert found is not None
        assert abs(found.scale - true) < 2.5 * found.std
        assert found.std < 0.02
        assert found.applied == (true != 1.0)


def test_right_file_is_left_as_it_is(solved: dict[str, SolvedSession]) -> None:
    calibration = solved["right"].calibration
    assert not any("eye" in text for text in (*calibration.warnings, *calibration.untold))
    assert not calibration.rig[0].differs
    np.testing.assert_array_equal(
        calibration.corrected_views(RIG.views)[1].view_from_camera, RIG.views[1].view_from_camera
    )


def test_each_wrong_length_is_one_warning(solved: dict[str, SolvedSession]) -> None:
    (text,) = [text for text in solved["baseline"].calibration.warnings if "eye" in text]
    assert text.startswith("the right eye's baseline is ")
    assert text.endswith(" longer than in the file")
    (text,) = [text for text in solved["focal"].calibration.warnings if "eye" in text]
    assert text.startswith("the right eye's focal length, relative to the first eye's, is ")
    assert text.endswith(" shorter than in the file")


@pytest.mark.parametrize("case", ["baseline", "focal"])
def test_frames_are_solved_with_the_rig_found(case: str, solved: dict[str, SolvedSession]) -> None:
    by_wrong, by_right = solved[case], solved["right"]
    one, other = (np.mean([iou for iou, _ in each.calibration.leave_one_out.values()]) for each in (by_wrong, by_right))
    assert one > other - 0.005
    of_views = by_wrong.calibration.leave_one_out_of_views
    assert list(of_views) == ["left", "right"]
    for name, (iou, contour_px) in by_wrong.calibration.leave_one_out.items():
        pairs = [of_views[view][name] for view in of_views]
        assert iou == pytest.approx(np.mean([pair[0] for pair in pairs]))
        assert contour_px == pytest.approx(np.mean([pair[1] for pair in pairs]))
    for result in by_wrong.results.values():
        assert result.status == by_right.results[result.frame].status


@pytest.mark.parametrize("case", ["baseline", "focal"])
def test_new_frame_is_seen_with_the_rig_found(
    case: str, bundled_body: Body, frames_of: dict[str, list[SessionFrame]], solved: dict[str, SolvedSession]
) -> None:
    calibration = SessionCalibration.from_dict(solved[case].calibration.to_dict())
    _, right = calibration.corrected_views(file_of(case).views)
    baseline, focal = (float(np.linalg.norm(right.view_from_camera[:3, 3])), right.camera.fx)
    assert abs(baseline / 0.0053 - 1) < 0.03
    assert abs(focal / SMALL.fx - 1) < 0.01
    frame = frames_of[case][0]
    assert isinstance(frame.data, FrameData)
    masks = {view.name: view.mask for view in frame.data.views}
    found = estimate(masks, file_of(case), frame.result.readings, bundled_body, session=calibration, config=SETTINGS)
    assert found.source == "session"
    assert found.quality is not None
    assert found.quality.iou > 0.95


def test_rig_that_was_used_is_written(solved: dict[str, SolvedSession], tmp_path: Path) -> None:
    calibration = solved["focal"].calibration
    write_cameras(calibration, file_of("focal"), tmp_path)
    rig = read_rig(tmp_path / "left.yaml", tmp_path / "right.yaml").rig
    used = calibration.corrected_views(file_of("focal").views)[1]
    np.testing.assert_allclose(rig.views[1].camera.matrix, used.camera.matrix)
    np.testing.assert_allclose(rig.views[1].view_from_camera, used.view_from_camera, atol=1e-9)


def test_arm_that_stays_where_it_is_does_not_tell_the_baseline(
    bundled_body: Body, frames_of: dict[str, list[SessionFrame]]
) -> None:
    distances = [float(frame.result.camera_from_root[2, 3]) for frame in frames_of["right"]]  # type: ignore[index]
    near = np.argsort(np.abs(np.array(distances) - np.median(distances)))[:4]
    frames = [frames_of["right"][k] for k in sorted(near)]
    calibration = calibrate_session(frames, bundled_body, config=SETTINGS).calibration
    baseline = calibration.rig[0].baseline
    told = any(text.startswith("baseline of the right eye: ") for text in calibration.untold)
    assert told == (baseline is None)
    assert baseline is None or baseline.std > 0.02


def test_rig_of_a_file_without_scales_is_read() -> None:
    view = ViewRotation("right", np.zeros(3), np.full(3, 0.02), 12, applied=False)
    assert (view.baseline, view.differs, view.warnings()) == (None, False, [])
    longer = replace(view, baseline=ViewScale(1.05, 0.01, applied=True))
    assert longer.warnings() == ["the right eye's baseline is 5.0 % (std 1.0) longer than in the file"]
    assert longer.differs
    assert longer.change.baseline == pytest.approx(np.log(1.05))
