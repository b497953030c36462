"""Images of synthetic recordings: the instrument where its mask is, before moving tissue, at each level."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import main
from helpers.moving_worlds import SMALL

from dvrk_cmaes import Body, Renderer, read_frame, read_session
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.synth.levels import LEVELS, LevelName
from dvrk_cmaes.synth.moving_arm import MOTION_LEVELS, moving_arm
from dvrk_cmaes.synth.moving_images import IMAGE_LEVELS, DrawnTool, ImageLevel, RecordingImages
from dvrk_cmaes.synth.passing import Occluder, passing_occluder
from dvrk_cmaes.synth.recording import Pictures, write_recording
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


def nothing() -> np.ndarray:
    """Coverage of an instrument that is out of view."""
    return np.zeros((SMALL.height, SMALL.width), np.float32)


def written(body: Body, folder: Path, pictures: Pictures, level: LevelName = "easy") -> Path:
    write_recording(folder, SessionPlan(body, SMALL, LEVELS[level], "video", FRAMES, 1, {}), pictures=pictures)
    return folder


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


def test_border_of_the_instrument_is_smooth(bundled_body: Body, truths: list[Truth]) -> None:
    coverage = exact_coverage(bundled_body, SMALL, truths[0])
    level = replace(STILL, shadow=0.0)
    drawn = images(level).draw(0, [DrawnTool(truths, coverage)]).astype(float)
    partly = (coverage > 0.3) & (coverage < 0.7)
    empty = images(level).draw(0, []).astype(float)
    whole = coverage == 1
    assert partly.any()
    for channel in range(3):
        low, high = np.percentile(np.r_[drawn[whole, channel], empty[..., channel].ravel()], [0, 100])
        assert (drawn[partly, channel] >= low - 1).all()
        assert (drawn[partly, channel] <= high + 1).all()


def test_tissue_moves_and_deforms() -> None:
    def difference(level: ImageLevel) -> float:
        drawn = images(replace(level, noise=0.0, smoke=0.0))
        first, later = (drawn.draw(number, []).astype(float) for number in (0, 30))
        return float(np.abs(first - later).mean())

    moved = [difference(IMAGE_LEVELS[name]) for name in ("clean", "easy", "hard")]
    assert moved[0] == 0
    assert 0.3 < moved[1] < moved[2]


def test_noise_grows_from_level_to_level() -> None:
    def noise(name: str) -> float:
        level = IMAGE_LEVELS[name]
        with_noise, without = (images(each).draw(0, []).astype(float) for each in (level, replace(level, noise=0)))
        return float(np.std(with_noise - without))

    sizes = [noise(name) for name in IMAGE_LEVELS]
    assert sizes == sorted(sizes)
    assert sizes[0] == 0
    assert sizes[-1] > 1


def test_shadow_falls_to_the_side_that_is_asked(bundled_body: Body, truths: list[Truth]) -> None:
    coverage = exact_coverage(bundled_body, SMALL, truths[0])
    drawn = images(STILL)
    shifted = cv2.warpAffine(coverage, np.float32([[1, 0, 0], [0, 1, 3]]), (SMALL.width, SMALL.height))
    below = (shifted > 0.9) & (coverage == 0)
    up, down = (drawn.draw(0, [DrawnTool(truths, coverage, angle)])[below].mean() for angle in (-np.pi / 2, np.pi / 2))
    assert down < 0.8 * up


@pytest.mark.parametrize("kind", ["shaft", "tissue"])
def test_what_passes_hides_the_instrument(bundled_body: Body, truths: list[Truth], kind: str) -> None:
    coverage = exact_coverage(bundled_body, SMALL, truths[0])
    region = np.zeros(coverage.shape, np.bool_)
    region[:, SMALL.width // 3 : 2 * SMALL.width // 3] = True
    occluder = Occluder(kind, region)  # type: ignore[arg-type]
    level = replace(STILL, shadow=0.0)
    with_tool, without = (images(level).draw(0, [DrawnTool(truths, each)], occluder) for each in (coverage, nothing()))
    inner = cv2.erode(region.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert (with_tool[inner] == without[inner]).all()
    assert (with_tool[~region] != without[~region]).any()


def test_fast_instrument_is_blurred_along_its_motion(bundled_body: Body, truths: list[Truth]) -> None:
    coverage = exact_coverage(bundled_body, SMALL, truths[0])
    quick = [truths[0], truths[0], truths[-1]]
    sharp, blurred = (
        images(replace(STILL, exposure=exposure)).draw(1, [DrawnTool(quick, coverage)]).astype(float)
        for exposure in (0.0, 1.0)
    )
    assert cv2.Laplacian(blurred, cv2.CV_64F).std() < 0.9 * cv2.Laplacian(sharp, cv2.CV_64F).std()


def test_images_lie_beside_masks_and_change_nothing_else(bundled_body: Body, tmp_path: Path) -> None:
    plain, drawn = written(bundled_body, tmp_path / "a", "none"), written(bundled_body, tmp_path / "b", "files")
    assert contents(drawn, "masks") == contents(plain, "masks")
    assert (drawn / "joints.csv").read_bytes() == (plain / "joints.csv").read_bytes()
    assert not (plain / "images").exists()
    session = read_session(drawn)
    assert [files.image and files.image.name for files in session.frames] == [f"{k:04d}.jpg" for k in range(FRAMES)]
    assert json.loads((drawn / "synth.json").read_text())["image_level"]["quality"] == IMAGE_LEVELS["easy"].quality


def test_same_seed_gives_same_images(bundled_body: Body, tmp_path: Path) -> None:
    once, again = (written(bundled_body, tmp_path / name, "files", "hard") for name in "ab")
    assert contents(once, "images") == contents(again, "images")


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


def test_left_eye_is_that_of_a_recording_of_one_view(bundled_body: Body, stereo: Path, tmp_path: Path) -> None:
    one = written(bundled_body, tmp_path / "one", "files", "medium")
    for part in ("masks", "images"):
        assert contents(stereo / part, "left") == contents(one, part)
    assert (stereo / "golden.json").read_bytes() == (one / "golden.json").read_bytes()


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


def test_command_writes_both_eyes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_camera_info(tmp_path / "small.yaml", SMALL, "small")
    line = ["--motion", "video", "--level", "clean", "--frames", "2", "--stereo"]
    assert main(["synth", str(tmp_path / "made"), *line, "--camera", str(tmp_path / "small.yaml")]) == 0
    for part, suffix in (("masks", "png"), ("images", "jpg")):
        for eye in ("left", "right"):
            assert sorted(contents(tmp_path / "made" / part, eye)) == [f"000{k}.{suffix}" for k in (0, 1)]
    assert (tmp_path / "made" / "right.yaml").is_file()
    assert main(["synth", str(tmp_path / "not"), *line, "--mp4"]) == 2
    assert "one eye only" in capsys.readouterr().err
