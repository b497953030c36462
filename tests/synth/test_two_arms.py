"""Synthetic sessions of two arms: labels, what hides what, and the truth of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dvrk_cmaes import Body, Camera, Renderer, read_frame, read_session
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.session_toml import ToolEntry, read_session_toml
from dvrk_cmaes.frames.tool_frames import frames_of_tool
from dvrk_cmaes.frames.truth import read_golden
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.two_arms import ARMS, hidden_shares, write_two_arms


@pytest.fixture(scope="module")
def folder(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    camera = Camera(320, 240, 513.0, 513.0, 161.0, 119.0)
    plan = SessionPlan(bundled_body, camera, LEVELS["easy"], "rcm", 2, 3, {})
    out = tmp_path_factory.mktemp("arms") / "session"
    write_two_arms(out, plan, ToolEntry("PSM1", "classic", "lnd"))
    return out


def test_nearer_tool_hides_the_other() -> None:
    first, second = np.full((2, 4, 4), np.inf, dtype=np.float32)
    first[:2], second[1:3] = 0.1, 0.2
    assert hidden_shares(first, second) == (0.0, 0.5)
    assert hidden_shares(second, first) == (0.5, 0.0)


def test_labels_show_both_tools_where_the_truth_says(folder: Path, bundled_body: Body) -> None:
    entries = read_session_toml(folder)
    assert entries is not None
    assert tuple(tool.arm for tool in entries.tools) == ARMS
    for tool in entries.tools:
        assert tool.joints is not None
        session = read_session(folder, joints=(tool.joints,))
        golden = read_golden(folder / f"golden_{tool.arm}.json")
        for files in frames_of_tool(session, entries, tool.arm).frames:
            truth, data = golden.frames[files.name], read_frame(files, session.camera)
            joints = np.array([[truth.joints[name] for name in bundled_body.instrument.joint_names]])
            drawn = Renderer(bundled_body, session.camera).masks(truth.camera_from_root[None], joints)[0]
            assert data.ignore is not None
            counts = ~data.ignore
            assert (drawn & data.mask & counts).sum() / ((drawn | data.mask) & counts).sum() > 0.9
            assert set(files.readings) >= {"insertion", "wrist_pitch"}


def test_tool_hides_part_of_the_other(folder: Path) -> None:
    shares = []
    for name in ("0000", "0001"):
        for label, arm in enumerate(ARMS, start=1):
            alone = read_mask(folder / "alone" / arm / f"{name}.png")
            seen = read_mask(folder / "masks" / f"{name}.png", label=label)
            shares.append(1 - (seen & alone).sum() / alone.sum())
    assert 0.02 < max(shares) < 0.4
