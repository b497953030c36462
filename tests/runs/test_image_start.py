"""The image from which a recording without masks is followed that has few keyframes: to its end, and back."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.moving_worlds import MovingWorld, moving_world

from dvrk_cmaes.camera import Rig
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.runs import image_start
from dvrk_cmaes.runs.track_clock import TrackClock
from dvrk_cmaes.runs.track_folder import track_folder
from dvrk_cmaes.runs.track_frames import TrackSettings, used_session
from dvrk_cmaes.synth.images import draw_image

FRAMES = 5
CLEAR = 3
SETTINGS = TrackSettings(EstimateConfig(), evidence="images", lag=0.0, workers=1)


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


@pytest.fixture(scope="module")
def session(world: MovingWorld, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of images and readings."""
    folder = tmp_path_factory.mktemp("start") / "session"
    (folder / "images").mkdir(parents=True)
    write_camera_info(folder / "camera.yaml", world.camera, "synth")
    names = list(world.readings[0])
    rows = [",".join((f"{k:04d}", *(f"{world.readings[k][name]:.9f}" for name in names))) for k in range(FRAMES)]
    (folder / "joints.csv").write_text("\n".join((",".join(("frame", *names)), *rows)) + "\n", encoding="utf-8")
    for k in range(FRAMES):
        image = draw_image(world.camera, world.truths[k], np.random.default_rng(5))
        (folder / "images" / f"{k:04d}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder


def test_recording_is_followed_in_both_directions_from_an_image_that_is_explained(
    world: MovingWorld, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def is_explained(files: FrameFiles, *rest: object) -> bool:
        asked.append(files.name)
        return files.name == f"{CLEAR:04d}"

    monkeypatch.setattr(image_start, "is_explained", is_explained)
    said: list[str] = []
    used, _ = used_session(read_session(session), "images")
    track_folder(used, tmp_path, world.body, SETTINGS, video=False, page=False, notice=said.append)
    assert asked == [f"{k:04d}" for k in range(CLEAR + 1)]
    assert said[-1].startswith(f"the images before frame {CLEAR:04d} do not show the instrument clearly")
    rows = read_tracks(tmp_path / "tracks.jsonl")
    assert [row["frame"] for row in rows] == [f"{k:04d}" for k in range(FRAMES)]
    off = [1e3 * np.linalg.norm(np.array(rows[k]["tips"]) - world.truths[k].tips, axis=1).mean() for k in range(FRAMES)]
    assert max(off) < 4


def test_image_without_the_instrument_is_not_explained(world: MovingWorld, tmp_path: Path) -> None:
    flat = np.full((world.camera.height, world.camera.width, 3), (60, 65, 150), np.uint8)
    flat[::7] += 9
    path = tmp_path / "flat.png"
    path.write_bytes(cv2.imencode(".png", flat)[1].tobytes())
    frames = [FrameFiles("a", None, image=path), FrameFiles("b", None, image=path)]
    rig = Rig.of_camera(world.camera)
    assert image_start.starting_frame(frames, rig, world.body, "classic", EstimateConfig(), use_joints=False) == 0


def test_first_frame_with_a_mask_is_where_to_start(world: MovingWorld) -> None:
    frames = [FrameFiles("a", Path("mask.png")), FrameFiles("b", None, image=Path("b.png"))]
    rig = Rig.of_camera(world.camera)
    assert image_start.starting_frame(frames, rig, world.body, "classic", EstimateConfig(), use_joints=True) == 0


def test_clock_that_runs_backwards_keeps_intervals() -> None:
    clock = TrackClock({"a": 0.0, "b": 0.1}, "s", 0.1, ((0.0, {"yaw": 1.0}), (0.05, {"yaw": 2.0})))
    back = image_start.mirrored(clock)
    assert back.times == {"a": 0.0, "b": -0.1}
    assert back.readings == ((-0.05, {"yaw": 2.0}), (0.0, {"yaw": 1.0}))
    assert back.interval == clock.interval
