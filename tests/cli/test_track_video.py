"""``dvrk-cmaes track`` by images: of a session's video, of a video of both eyes, of a ROS recording; and wrong use."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import run_command
from helpers.files import read_tracks, write_image
from helpers.made_recordings import ARM, BEGIN, SECOND, camera_info, image, jaw, joints, write_bag
from helpers.moving_worlds import SMALL, MovingWorld, drawn, moving_world

from dvrk_cmaes.frames.video_frames import Video

FRAMES = 6
CAMERA = f"""image_width: {SMALL.width}
image_height: {SMALL.height}
camera_matrix: {{rows: 3, cols: 3, data: [{SMALL.fx}, 0, {SMALL.cx}, 0, {SMALL.fy}, {SMALL.cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
"""


@pytest.fixture(scope="module")
def world() -> MovingWorld:
    return moving_world()


@pytest.fixture(scope="module")
def images(world: MovingWorld) -> list[np.ndarray]:
    return drawn(world, FRAMES)


def write_video(path: Path, images: list[np.ndarray]) -> Path:
    """Write a video without losses."""
    height, width = images[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 30.0, (width, height))
    for shown in images:
        video.write(shown)
    video.release()
    return path


@pytest.fixture(scope="module")
def session(world: MovingWorld, images: list[np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session with a video, the mask of the first frame beside it."""
    folder = tmp_path_factory.mktemp("video") / "session"
    folder.mkdir()
    (folder / "camera.yaml").write_text(CAMERA, encoding="utf-8")
    names = list(world.readings[0])
    rows = [",".join(["frame", "time", *names])]
    for k in range(FRAMES):
        rows.append(",".join([f"{k:04d}", f"{world.time(k):.6f}", *(f"{world.readings[k][n]:.9f}" for n in names)]))
    (folder / "joints.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_video(folder / "film.avi", images)
    (folder / "film.avi").rename(folder / "video.mp4")
    write_image(folder / "first.png", world.masks[0])
    return folder


def test_video_is_sent_to_another_process(session: Path) -> None:
    video = Video(session / "video.mp4")
    sent = pickle.loads(pickle.dumps(video))
    assert np.array_equal(sent.image(3), video.image(3))


def error_mm(world: MovingWorld, row: dict[str, object], frame: int) -> float:
    return 1e3 * float(np.linalg.norm(np.array(row["tips"]) - world.truths[frame].tips, axis=1).mean())


def follow(capsys: pytest.CaptureFixture[str], source: Path, out: Path, *options: object) -> list[dict[str, object]]:
    """Follow a source and return the rows of tracks.jsonl."""
    ran = run_command(capsys, "track", source, "--out", out, "--lag", "0", *options)
    assert ran.code in (0, 3), ran.err
    return read_tracks(out / "tracks.jsonl")


def test_video_of_a_session_is_followed(
    world: MovingWorld, session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = follow(capsys, session, tmp_path / "out", "--first-mask", session / "first.png")
    assert [row["frame"] for row in rows] == [f"{k:04d}" for k in range(FRAMES)]
    assert rows[-1]["status"] == "doubtful"  # of so few frames, nothing tells the base
    assert max(error_mm(world, row, k) for k, row in enumerate(rows)) < 2
    film = cv2.VideoCapture(str(tmp_path / "out" / "tracks.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    film.release()


def test_readings_of_a_video_may_have_times_alone(
    session: Path, world: MovingWorld, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(session, tmp_path / "timed")
    rows = (session / "joints.csv").read_text(encoding="utf-8").splitlines()
    shifted = [rows[0].partition(",")[2]]
    for row in rows[1:]:
        _, time, *rest = row.split(",")
        shifted.append(",".join([f"{float(time) + 5:.6f}", *rest]))
    (tmp_path / "timed" / "joints.csv").write_text("\n".join(shifted) + "\n", encoding="utf-8")
    timed, imported = tmp_path / "timed", tmp_path / "imported"
    files = timed / "video.mp4", "--camera", timed / "camera.yaml", "--joints", timed / "joints.csv"
    assert run_command(capsys, "import", *files, "--video-start", "5", "--out", imported).code == 0
    found = follow(capsys, imported, tmp_path / "out", "--first-mask", session / "first.png", "--no-video")
    assert len(found) == FRAMES
    assert error_mm(world, found[-1], FRAMES - 1) < 2


def test_video_without_readings_is_followed(
    session: Path, world: MovingWorld, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(session, tmp_path / "alone")
    (tmp_path / "alone" / "joints.csv").unlink()
    found = follow(capsys, tmp_path / "alone", tmp_path / "out", "--first-mask", session / "first.png", "--no-video")
    assert len(found) == FRAMES
    assert all(row["camera_from_root"] is not None for row in found)


def test_ros_recording_is_followed(
    session: Path, world: MovingWorld, images: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    k = np.array([SMALL.fx, 0, SMALL.cx, 0, SMALL.fy, SMALL.cy, 0, 0, 1], np.float64)
    size = {"height": SMALL.height, "width": SMALL.width}
    messages = [camera_info(BEGIN, d=np.zeros(5), k=k, p=np.zeros(12), **size)]
    for number, (pixels, read) in enumerate(zip(images, world.readings, strict=False)):
        time = BEGIN + round(world.time(number) * SECOND)
        messages += [image(time, pixels), joints(time, [read[name] for name in ARM]), jaw(time, read["jaw"])]
    bag = write_bag(tmp_path / "bag", "mcap", messages)
    found = follow(capsys, bag, tmp_path / "out", "--first-mask", session / "first.png", "--no-video")
    assert len(found) == FRAMES
    assert error_mm(world, found[-1], FRAMES - 1) < 2


def test_masks_count_where_there_are_any(
    session: Path, world: MovingWorld, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(session, tmp_path / "masked")
    for k in range(FRAMES):
        write_image(tmp_path / "masked" / "masks" / f"{k:04d}.png", world.masks[k])
    out = tmp_path / "out"
    rows = follow(capsys, tmp_path / "masked", out, "--no-video")
    assert max(error_mm(world, row, k) for k, row in enumerate(rows)) < 1.0
    assert json.loads((out / "run.json").read_text(encoding="utf-8"))["track"]["evidence"] == "masks"


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--evidence", "masks"], "--evidence masks: expected masks of the frames, got none"),
        (["--layout", "side-by-side"], "--layout: no option here; use `dvrk-cmaes import`"),
        (["--crop=1,2,3,4"], "--crop: no option here; use right, crop or stretch of [camera] in session.toml"),
        (["--seed", "3"], "--seed: no option here; use seed in the settings file (--config)"),
        (["--first-mask", "none.png"], "none.png: no such file"),
        (["--box", "1,2,3"], "--box: expected x0,y0,x1,y1 in pixels, got '1,2,3'"),
    ],
)
def test_wrong_options_are_refused(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], expected: str
) -> None:
    ran = run_command(capsys, "track", session, "--out", tmp_path / "out", *options)
    assert ran.code == 2
    assert expected in ran.err


def test_images_that_are_not_there_are_missed(
    session: Path, world: MovingWorld, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(session, tmp_path / "blind")
    (tmp_path / "blind" / "video.mp4").unlink()
    write_image(tmp_path / "blind" / "masks" / "0000.png", world.masks[0])
    ran = run_command(capsys, "track", tmp_path / "blind", "--out", tmp_path / "out", "--evidence", "images")
    assert "--evidence images: expected images or video.mp4, got neither" in ran.refusal


def test_video_with_other_frames_than_the_readings_is_refused(
    session: Path, tmp_path: Path, images: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(session, tmp_path / "short")
    path = write_video(tmp_path / "short" / "film.avi", images[:-1])
    ran = run_command(capsys, "track", path, "--out", tmp_path / "out")
    assert f"film.avi: expected {FRAMES} frames, as joints.csv has, got {FRAMES - 1}" in ran.refusal
