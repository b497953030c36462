"""Synthetic recordings of two arms: motion, readings, occlusion by depth, and the pictures of both eyes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import run_command
from helpers.moving_worlds import SMALL

from dvrk_cmaes import Body, Renderer, Session, read_frame, read_session
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.frames.session_toml import ToolEntry
from dvrk_cmaes.frames.truth import SessionTruth, read_golden
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.truth import Truth
from dvrk_cmaes.synth.two_arms import ARMS, tool_depth
from dvrk_cmaes.synth.two_arms_recording import write_recording_of_arms

FRAMES = 2
NAMES = [f"{k:04d}" for k in range(FRAMES)]
TOOL = ToolEntry("PSM1", "classic", "lnd")


@pytest.fixture(scope="module")
def plan(bundled_body: Body) -> SessionPlan:
    return SessionPlan(bundled_body, SMALL, LEVELS["clean"], "video", FRAMES, 3, {}, baseline=0.0053)


@pytest.fixture(scope="module")
def folder(plan: SessionPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of both eyes with images."""
    out = tmp_path_factory.mktemp("arms") / "session"
    write_recording_of_arms(out, plan, TOOL, pictures="files")
    return out


def session_of(folder: Path, arm: str) -> Session:
    return read_session(folder, arm=arm)


def truths_of(folder: Path, body: Body) -> list[list[Truth]]:
    """Read the true poses of both arms."""
    found: list[SessionTruth] = [read_golden(folder / f"golden_{arm}.json") for arm in ARMS]
    return [
        [Truth(body.instrument, of_arm.frames[name].camera_from_root, of_arm.frames[name].joints) for name in NAMES]
        for of_arm in found
    ]


def test_both_eyes_see_each_tool_where_its_truth_says(folder: Path, plan: SessionPlan) -> None:
    for arm, truths in zip(ARMS, truths_of(folder, plan.body), strict=True):
        session = session_of(folder, arm)
        for files, truth in zip(session.frames, truths, strict=True):
            data = read_frame(files, session.rig)
            for view, seen in zip(session.rig.views, data.views, strict=True):
                pose = view.view_from_camera @ truth.camera_from_root
                drawn = Renderer(plan.body, view.camera).masks(pose[None], truth.values[None])[0]
                counts = np.ones_like(drawn) if seen.ignore is None else ~seen.ignore
                assert (drawn & seen.mask & counts).sum() / ((drawn | seen.mask) & counts).sum() > 0.97


def test_images_show_the_nearer_tool(folder: Path, plan: SessionPlan, tmp_path: Path) -> None:
    """Where one tool hides the other, the image is that of a recording in which the hidden one is elsewhere."""
    one = tmp_path / "one"
    write_recording(one, replace(plan, baseline=None), pictures="files")
    first, second = truths_of(folder, plan.body)
    image, lone = (read_image(path).astype(int) for path in (folder / "images/left/0000.jpg", one / "images/0000.jpg"))
    depths = [tool_depth(plan.body, SMALL, truths[0]) for truths in (first, second)]
    kernel = np.ones((5, 5), np.uint8)
    near, far = depths[0] < depths[1], depths[1] < depths[0]
    near, far = (cv2.erode(region.astype(np.uint8), kernel) > 0 for region in (near, far))
    assert np.abs(image - lone)[near].mean() < 3
    assert np.abs(image - lone)[far].mean() > 10


def test_each_arm_has_readings_a_lag_and_a_base_of_its_own(folder: Path) -> None:
    sessions = [session_of(folder, arm) for arm in ARMS]
    for session in sessions:
        series = session.reading_series()
        assert series is not None
        assert series.interval == pytest.approx(1 / 30, abs=1e-6)
    assert sessions[0].frames[0].readings != sessions[1].frames[0].readings
    bases = [read_golden(folder / f"golden_{arm}.json").camera_from_base for arm in ARMS]
    assert bases[0] is not None
    assert bases[1] is not None
    assert not np.allclose(bases[0], bases[1], atol=1e-2)
    visible = json.loads((folder / "golden_PSM2.json").read_text(encoding="utf-8"))["frames"]["0000"]["visible"]
    assert 0 < visible <= 1


def test_command_writes_two_arms_whose_lags_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = tmp_path / "camera.yaml"
    write_camera_info(camera, SMALL, "small")
    line = (
        "synth",
        tmp_path / "made",
        "--motion",
        "video",
        "--arms",
        2,
        "--frames",
        1,
        "--no-images",
        "--camera",
        camera,
    )
    ran = run_command(capsys, *line)
    assert ran.code == 0, ran.err
    lags = json.loads((tmp_path / "made" / "synth.json").read_text(encoding="utf-8"))["lags"]
    assert lags["PSM1"] == 1.5
    assert 0.75 <= lags["PSM2"] <= 2.25
    assert lags["PSM1"] != lags["PSM2"]
    assert not (tmp_path / "made" / "images").exists()
    run_command(capsys, *line, "--lag", "0.1", "--overwrite")
    lags = json.loads((tmp_path / "made" / "synth.json").read_text(encoding="utf-8"))["lags"]
    assert lags == {"PSM1": pytest.approx(3.0), "PSM2": pytest.approx(3.0)}


@pytest.mark.parametrize("wrong", [("--motion", "free"), ("--stereo",)])
def test_command_refuses_other_sessions_of_two_arms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: tuple[str, ...]
) -> None:
    refusal = run_command(capsys, "synth", tmp_path / "made", "--arms", 2, *wrong).refusal
    assert refusal == "--arms: expected --motion video, or --motion rcm and one eye, with two arms"
