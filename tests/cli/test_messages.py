"""Messages about arguments: what is missing, what has no value, and what does not exist is said first."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import run_command

from dvrk_cmaes.io.bundled import bundled_path

DEMO = bundled_path("demo")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("estimate", "--mask", "a.png"), "--joints: missing; it is required (see dvrk-cmaes estimate --help)"),
        (
            ("estimate", "--mask", "a.png", "--joints", "a.csv"),
            "--camera: missing; it is required (see dvrk-cmaes estimate --help)",
        ),
        (
            ("estimate", "--mask", "a.png", "--camera", "c.yaml", "--joint", "a.csv"),
            "--joint: no such option; did you mean --joints? (see dvrk-cmaes estimate --help)",
        ),
        (("pnp", "session"), "--out: missing; it is required (see dvrk-cmaes pnp --help)"),
        (("export", "--to", "tf"), "RESULTS: missing; it is required (see dvrk-cmaes export --help)"),
    ],
)
def test_argument_that_is_not_given_is_missing(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    assert run_command(capsys, *arguments).refusal == expected


def test_option_without_value_requires_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--mask requires an argument" in run_command(capsys, "estimate", "--mask").refusal


def test_missing_recording_is_named_before_missing_library(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    original = builtins.__import__

    def without_rosbags(name: str, *more: Any, **named: Any) -> Any:
        if name.startswith("rosbags"):
            raise ImportError(name)
        return original(name, *more, **named)

    monkeypatch.setattr(builtins, "__import__", without_rosbags)
    nothere = tmp_path / "nothere.bag"
    refusal = run_command(capsys, "import", nothere, "--out", tmp_path / "out").refusal
    assert refusal == f"{nothere}: no such file; expected a ROS recording"


def test_close_setting_is_suggested_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text("seeed = 3\n")
    frame = ("--mask", DEMO / "masks" / "0001.png", "--camera", DEMO / "camera.yaml", "--joints", DEMO / "joints.csv")
    refusal = run_command(capsys, "estimate", *frame, "--config", tmp_path / "own.toml").refusal
    assert refusal == f"{tmp_path}/own.toml: unknown key seeed; the nearest known is seed"
