"""Images of synthetic recordings: the instrument where its mask is, before moving tissue, at each level."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import main
from helpers.moving_worlds import SMALL

from dvrk_cmaes import Body, Renderer, read_frame, read_session
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.moving_arm import MOTION_LEVELS, moving_arm
from dvrk_cmaes.synth.moving_images import IMAGE_LEVELS, DrawnTool, ImageLevel, RecordingImages
from dvrk_cmaes.synth.passing import passing_occluder
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.truth import Truth, exact_coverage

FRAMES = 4
STILL = IMAGE_LEVELS["clean"]


@pytest.fixture(scope="module")
def truths(bundled_body: Body) -> list[Truth]:
    _, drawn, _ = moving_arm(bundled_body, SMALL, np.random.default_rng(3), 40, MOTION_LEVELS["clean"])
    return drawn


def images(level: ImageLevel, seed: int = 1) -> RecordingImages:
    return RecordingImages(SMALL, level, (seed,), 1 / 30)


def contents(folder: Path, part: str) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / part).iterdir())}


def test_instrument_is_drawn_where_its_mask_is(bundled_body: Body, truths: list[Truth]) -> None:
    coverage = exact_coverage(bundled_body, SMALL, truths[0])
    drawn = images(replace(STILL, shadow=0.0)).draw(0, [DrawnTool(truths, coverage)])
    empty = images(STILL).draw(0, [])
    changed = np.abs(drawn.astype(int) - empty).max(axis=2) > 8
    mask = coverage > 0.5
    assert (changed & mask).sum() / (changed | mask).sum() > 0.93
    inside = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    colour, tissue = drawn[inside].mean(axis=0), drawn[~mask].mean(axis=0)
    assert np.ptp(colour) < 0.1 * colour.mean()  # metal is grey
    assert tissue[2] > 2 * tissue[0]  # tissue is red


def test_command_writes_images_files_or_a_video(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["--motion", "video", "--level", "easy", "--frames", "2"]
    assert main(["synth", str(tmp_path / "files"), *line]) == 0
    assert main(["synth", str(tmp_path / "video"), *line, "--mp4"]) == 0
    assert main(["synth", str(tmp_path / "masks"), *line, "--no-images"]) == 0
    assert sorted(contents(tmp_path / "files", "images")) == ["0000.jpg", "0001.jpg"]
    assert not (tmp_path / "video" / "images").exists()
    assert not (tmp_path / "masks" / "images").exists()
    video = cv2.VideoCapture(str(tmp_path / "video" / "video.mp4"))
    seen = [video.read() for _ in range(3)]
    video.release()
    assert [read for read, _ in seen] == [True, True, False]
    first = cv2.imread(str(tmp_path / "files" / "images" / "0000.jpg"))
    assert np.abs(seen[0][1].astype(int) - first).mean() < 8
    assert main(["synth", str(tmp_path / "not"), "--mp4"]) == 2
    assert "--mp4: expected it with --motion video, --images and one eye only" in capsys.readouterr().err


# two eyes


@pytest.fixture(scope="module")
def stereo(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two eyes in which another shaft passes."""
    folder = tmp_path_factory.mktemp("stereo") / "recording"
    plan = SessionPlan(bundled_body, SMALL, LEVELS["medium"], "video", FRAMES, 1, {}, baseline=0.0053)
    write_recording(folder, plan, pictures="files")
    return folder


def test_masks_of_both_eyes_show_the_true_pose(bundled_body: Body, stereo: Path) -> None:
    session = read_session(stereo)
    for files in session.frames:
        truth = session.truth.frames[files.name]
        joints = np.array([[truth.joints[name] for name in bundled_body.instrument.joint_names]])
        data = read_frame(files, session.rig)
        for view, mask in zip(session.rig.views, [view.mask for view in data.views], strict=True):
            pose = view.view_from_camera @ truth.camera_from_root
            drawn = Renderer(bundled_body, view.camera).masks(pose[None], joints)[0]
            assert (drawn & mask).sum() > 0.85 * mask.sum()


def test_farther_things_are_shifted_less_from_eye_to_eye(truths: list[Truth]) -> None:
    left, right = (RecordingImages(SMALL, STILL, (1,), 1 / 30, baseline).draw(0, []) for baseline in (0.0, 0.0053))
    rows = slice(60, 180)  # the light is that of each eye, so places are found by correlation
    part = np.ascontiguousarray(left[rows, 120:240])
    found = cv2.minMaxLoc(cv2.matchTemplate(np.ascontiguousarray(right[rows]), part, cv2.TM_CCOEFF_NORMED))
    assert found[1] > 0.9
    assert 120 - found[3][0] == pytest.approx(SMALL.fx * 0.0053 / 0.16, abs=1)
    shaft = [passing_occluder(SMALL, truths[0], 0.36, np.random.default_rng(0), baseline) for baseline in (0.0, 0.0053)]
    assert None not in shaft
    middles = [np.nonzero(each.region[120])[0].mean() for each in shaft if each is not None]
    assert middles[0] - middles[1] == pytest.approx(SMALL.fx * 0.0053 / 0.06, abs=1)
