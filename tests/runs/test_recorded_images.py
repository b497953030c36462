"""A recording without masks, followed by keyframes whose masks are found in its images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.followed_folder import track_folder
from helpers.session_worlds import SMALL, make_frames_in_memory, write_folder

from dvrk_cmaes import EstimateConfig, FrameData, prepare, read_calibration, read_session
from dvrk_cmaes.results.track_files import read_tracks
from dvrk_cmaes.runs.track import TrackSettings
from dvrk_cmaes.runs.track_inputs import used_session
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.synth.truth import Truth

FRAMES = 13
GONE, OTHER = "0005", "0009"
SETTINGS = TrackSettings(EstimateConfig(), evidence="images", workers=1)

Recording = tuple[Path, dict[str, Truth]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A session with masks that are too wide, and images; one shows tissue alone, one another instrument's shaft."""
    folder = tmp_path_factory.mktemp("recorded") / "session"
    _, truths, frames = make_frames_in_memory(prepare("lnd"), FRAMES, seed=5)
    wide = [replace(frame, data=widened(frame.data)) for frame in frames]
    write_folder(folder, wide)
    (folder / "images").mkdir()
    for frame, truth in zip(frames, truths, strict=True):
        image = draw_image(SMALL, truth, np.random.default_rng(5))
        if frame.name == GONE:
            image = tissue()
        if frame.name == OTHER:
            image = tissue()
            cv2.line(image, (40, 0), (200, 239), (96, 98, 95), 34)
        (folder / "images" / f"{frame.name}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return folder, {frame.name: truth for frame, truth in zip(frames, truths, strict=True)}


def widened(data: object) -> FrameData:
    """Add some pixels to one side of a mask, as a segmenter does that takes a shadow for the instrument."""
    assert isinstance(data, FrameData)
    moved = np.roll(data.mask, (4, 3), (0, 1))
    return FrameData.of(data.mask | moved, data.camera, None)


def tissue() -> np.ndarray:
    """Draw an image without the instrument."""
    rng = np.random.default_rng(1)
    noise = cv2.GaussianBlur(rng.normal(size=(SMALL.height, SMALL.width, 3)), (0, 0), 5)
    return np.asarray(np.clip(np.array([60, 65, 150]) + 60 * noise, 0, 255), np.uint8)


def follow(folder: Path, out: Path, settings: TrackSettings = SETTINGS) -> list[str]:
    """Follow a session by its images, and return what is said."""
    said: list[str] = []
    session, _ = used_session(read_session(folder), settings.evidence)
    track_folder(session, out, prepare("lnd"), settings, video=False, page=False, notice=said.append)
    return said


@pytest.fixture(scope="module")
def tracks(made: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results by images."""
    out = tmp_path_factory.mktemp("tracks")
    said = follow(made[0], out)
    assert said[0] == f"finding masks: {FRAMES} frames"
    assert not any("from image to image" in text for text in said)
    return out


def tip_error_mm(row: dict[str, object], truth: Truth) -> float:
    return 1e3 * float(np.linalg.norm(np.array(row["tips"]) - truth.tips, axis=1).mean())


def shown(tracks: Path) -> list[dict[str, object]]:
    return [row for row in read_tracks(tracks / "tracks.jsonl") if row["frame"] not in (GONE, OTHER)]


def test_every_pose_is_near_the_truth_and_within_its_stated_error(made: Recording, tracks: Path) -> None:
    rows = shown(tracks)
    errors = np.array([tip_error_mm(row, made[1][row["frame"]]) for row in rows])
    assert len(rows) == FRAMES - 2
    assert np.median(errors) < 1.0
    assert (errors / [row["std"]["tip_mm"] for row in rows]).max() < 3.5
    assert sum(row["status"] == "ok" for row in rows) >= FRAMES // 2


def test_images_that_do_not_show_the_instrument_are_not_ok_and_teach_nothing(made: Recording, tracks: Path) -> None:
    rows = {row["frame"]: row for row in read_tracks(tracks / "tracks.jsonl")}
    assert rows[GONE]["status"] == "lost"
    assert rows[GONE]["reasons"] == ["lost: the image shows nothing of the instrument"]
    assert rows[OTHER]["status"] in ("doubtful", "lost")
    used = read_calibration(tracks / "session.json").frames
    assert not {GONE, OTHER} & {*used}
    assert len(used) >= 10


def test_given_calibration_needs_images_only_for_colours(made: Recording, tracks: Path, tmp_path: Path) -> None:
    given = replace(SETTINGS, calibration=read_calibration(tracks / "session.json"))
    assert follow(made[0], tmp_path, given) == [f"finding masks: {FRAMES} frames", f"fitting {FRAMES} frames"]
    pairs = zip(shown(tmp_path), shown(tracks), strict=True)
    assert all(np.allclose(own["tips"], other["tips"], atol=4e-4) for own, other in pairs)
