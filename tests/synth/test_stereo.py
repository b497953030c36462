"""Synthetic sessions of two eyes: the masks of one pose in both, and the same left eye as without the right one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.files import read_mask

from dvrk_cmaes import Body, Camera, Renderer, read_frame, read_session
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.session import SessionPlan, write_session

BASELINE = 0.0053


@pytest.fixture(scope="module")
def plan(bundled_body: Body) -> SessionPlan:
    camera = Camera(320, 240, 513.0, 513.0, 161.0, 119.0)
    return SessionPlan(bundled_body, camera, LEVELS["medium"], "free", 2, 5, {}, baseline=BASELINE)


@pytest.fixture(scope="module")
def folder(plan: SessionPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("stereo") / "session"
    write_session(out, plan, images=False)
    return out


def test_both_masks_show_the_true_pose(folder: Path, plan: SessionPlan) -> None:
    session = read_session(folder)
    assert session.rig.view("right").view_from_camera[0, 3] == pytest.approx(-BASELINE)
    for files in session.frames:
        truth = session.truth.frames[files.name]
        joints = np.array([[truth.joints[name] for name in plan.body.instrument.joint_names]])
        data = read_frame(files, session.rig)
        for view, seen in zip(session.rig.views, data.views, strict=True):
            pose = view.view_from_camera @ truth.camera_from_root
            drawn = Renderer(plan.body, view.camera).masks(pose[None], joints)[0]
            counts = np.ones_like(drawn) if seen.ignore is None else ~seen.ignore
            overlap = (drawn & seen.mask & counts).sum() / ((drawn | seen.mask) & counts).sum()
            assert overlap > 0.85


def test_mistakes_of_the_eyes_differ(folder: Path) -> None:
    left, right = (read_mask(folder / "masks" / side / "0000.png") for side in ("left", "right"))
    shifts = [np.roll(right, shift, axis=1) for shift in range(60)]
    assert min((left ^ shifted).sum() for shifted in shifts) > 50


def test_left_eye_is_that_of_a_session_of_one_view(folder: Path, plan: SessionPlan, tmp_path: Path) -> None:
    write_session(tmp_path / "one", replace(plan, baseline=None), images=False)
    for name in ("0000.png", "0001.png"):
        alone, left = tmp_path / "one" / "masks" / name, folder / "masks" / "left" / name
        assert alone.read_bytes() == left.read_bytes()
