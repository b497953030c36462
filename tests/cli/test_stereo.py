"""``estimate`` and ``batch`` with both eyes of a stereo endoscope."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK
from helpers.commands import run_command
from helpers.stereo_sessions import JOINTS, make_stereo_session

from dvrk_cmaes import Body

pytestmark = pytest.mark.usefixtures("tasks_here")

READ = ",".join(f"{name}={value}" for name, value in JOINTS.items())


@pytest.fixture
def folder(tmp_path: Path, bundled_body: Body) -> Path:
    (tmp_path / "quick.toml").write_text(QUICK, encoding="utf-8")
    return make_stereo_session(tmp_path / "session", bundled_body)


def test_changed_mask_of_the_right_view_is_noticed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, quick = folder.parent / "out", folder.parent / "quick.toml"
    arguments = ("batch", folder, "--out", out, "--config", quick, "--workers", 1, "--frames", "0000")
    run_command(capsys, *arguments)
    right = folder / "masks" / "right"
    (right / "0000.png").write_bytes((right / "0001.png").read_bytes())
    ran = run_command(capsys, *arguments)
    assert ran.code == 2
    assert "frames have changed since their results were made: 0000 (right mask)" in ran.err


def test_estimate_takes_the_right_eye_too(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    masks, quick = folder / "masks", folder.parent / "quick.toml"
    ran = run_command(
        capsys,
        *("estimate", "--mask", masks / "left" / "0000.png", "--mask-right", masks / "right" / "0000.png"),
        *("--camera", folder / "left.yaml", "--camera-right", folder / "right.yaml", "--joints", READ),
        *("--config", quick, "--json", "--out", folder.parent / "one"),
    )
    result = json.loads(ran.out)
    assert result["views"] == ["left", "right"]
    assert (folder.parent / "one" / "overlays" / "0000.jpg").is_file()


def test_right_mask_needs_the_cameras_of_both_eyes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    masks = folder / "masks"
    ran = run_command(
        capsys,
        *("estimate", "--mask", masks / "left" / "0000.png", "--mask-right", masks / "right" / "0000.png"),
        *("--camera", folder / "left.yaml", "--joints", READ),
    )
    assert ran.code == 2
    assert "left.yaml: expected both eyes" in ran.err
