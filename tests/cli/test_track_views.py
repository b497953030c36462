"""``dvrk-cmaes track`` on sessions of two eyes, and of several arms."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.batch_sessions import QUICK
from helpers.commands import main, run_command
from helpers.files import write_json
from helpers.moving_worlds import SMALL, MovingWorld, followed, moving_world
from helpers.transforms import transform

from dvrk_cmaes import EstimateConfig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.synth.truth import exact_mask
from dvrk_cmaes.track.reading_buffer import ReadingBuffer
from dvrk_cmaes.track.unknown_base import wide_calibration

FRAMES = 6
ARMS = {"PSM1": 3, "PSM2": 2}
"""The arms, and the seeds of their motion."""


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("settings") / "quick.toml"
    path.write_text(QUICK, encoding="utf-8")
    return path


@cache
def world_of(arm: str) -> MovingWorld:
    """Give a moving arm, each on its side of the image."""
    world, side = moving_world(FRAMES, ARMS[arm]), transform(np.eye(3), [-0.008 if arm == "PSM1" else 0.008, 0, 0])
    truths = [replace(truth, camera_from_root=side @ truth.camera_from_root) for truth in world.truths]
    return replace(world, truths=truths, masks=[exact_mask(world.body, SMALL, truth) for truth in truths])


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two arms that cross, in masks of labels."""
    folder = tmp_path_factory.mktemp("two_arms") / "session"
    (folder / "masks").mkdir(parents=True)
    for k in range(FRAMES):
        labels = np.zeros((SMALL.height, SMALL.width), np.uint8)
        for label, arm in enumerate(ARMS, start=1):
            labels[world_of(arm).masks[k]] = label
        (folder / "masks" / f"{k:04d}.png").write_bytes(cv2.imencode(".png", labels)[1].tobytes())
    intrinsic = SMALL.matrix.tolist()
    (folder / "camera.yaml").write_text(json.dumps({"intrinsic": intrinsic, "distortion": [0.0] * 5}), encoding="utf-8")
    lines = []
    for label, arm in enumerate(ARMS, start=1):
        world = world_of(arm)
        names = list(world.readings[0])
        rows = [["frame", "time", *names]]
        rows += [[f"{k:04d}", world.time(k), *(world.readings[k][name] for name in names)] for k in range(FRAMES)]
        text = "".join(",".join(map(str, row)) + "\n" for row in rows)
        (folder / f"joints_{arm}.csv").write_text(text, encoding="utf-8")
        lines.append(f'[[tool]]\narm = "{arm}"\ninstrument = "lnd"\nlabel = {label}\njoints = "joints_{arm}.csv"\n')
    (folder / "session.toml").write_text("".join(lines), encoding="utf-8")
    return folder


# both eyes


# several arms


@pytest.fixture(scope="module")
def tracks(two_arms: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tracks")
    assert main(["track", str(two_arms), "--out", str(out), "--lag", "0"]) in (0, 3)
    return out


def test_base_of_an_arm_is_exported(tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(tracks, tmp_path / "tracks")
    world = world_of("PSM2")
    truth, names = world.truths[0], world.body.instrument.joint_names
    readings = ReadingBuffer(names, 0.2, 1.0)
    readings.add(0.0, world.readings[0])
    at = Posed(truth.camera_from_root, truth.values)
    given = followed(world, EstimateConfig())
    found = wide_calibration(at, 1e-6 * np.eye(6 + len(names)), readings.at(0.0), given)
    write_json(tmp_path / "tracks" / "PSM2" / "session.json", found.to_dict())
    arguments = ("--to", "tf", "--arm", "PSM2", "--out", tmp_path / "tf", "--json")
    ran = run_command(capsys, "export", tmp_path / "tracks", *arguments)
    assert ran.code == 0, ran.err
    written = json.loads(ran.out)["written"]
    assert "PSM2_base" in Path(written[0]).read_text(encoding="utf-8")


def test_one_arm_can_be_chosen(two_arms: Path, tmp_path: Path, quick: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--config", quick, "--only", "PSM2", "--lag", "0", "--every", "3", "--no-video", "--no-page")
    ran = run_command(capsys, "track", two_arms, "--out", tmp_path, *options)
    assert ran.code in (0, 3)
    assert [path.name for path in tmp_path.iterdir()] == ["PSM2", "run.json"]
    assert len(read_tracks(tmp_path / "PSM2" / "tracks.jsonl")) == 2


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--first-mask", "a.png"), "--first-mask: expected one arm (--only ARM), got a session of several"),
        (("--box", "1,2,30,40"), "--box, --point: expected one arm (--only ARM)"),
        (("--joints", "joints_PSM1.csv"), "--joints FILE: expected one arm (--only ARM)"),
        (
            ("--session", "session.json"),
            "--session: expected the folder that calibrate wrote, with a session.json for each arm, got ",
        ),
        (("--only", "PSM3"), "arm: expected one of"),
    ],
)
def test_options_of_one_arm_are_refused(
    two_arms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], expected: str
) -> None:
    files = [two_arms / option if option.endswith("1.csv") else option for option in options]
    assert expected in run_command(capsys, "track", two_arms, "--out", tmp_path / "out", *files).refusal
