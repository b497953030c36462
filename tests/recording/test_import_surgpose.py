"""``dvrk-cmaes import`` of folders in the layout of SurgPose, and poses in pixels at its labels."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ran, run_command
from helpers.files import write_json
from helpers.made_surgpose import ARMS, CAMERA, FRAMES, NUMBERS, MadeArms, calibration_ini, made_arms, write_surgpose
from helpers.places import bundled_path

from dvrk_cmaes import EstimateConfig, prepare, read_session
from dvrk_cmaes.frames.markers import place_markers, read_detections, read_marker_table
from dvrk_cmaes.runs.keyframes import segment_task
from dvrk_cmaes.segment.segmentation import SegmentSettings

pytestmark = pytest.mark.usefixtures("searches_short")

Run = Callable[..., Ran]


@pytest.fixture(scope="module")
def arms() -> MadeArms:
    return made_arms()


@pytest.fixture(scope="module")
def made(arms: MadeArms, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_surgpose(tmp_path_factory.mktemp("surgpose") / "000000", arms)


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """Give a copy of the folder that a test may change."""
    return Path(shutil.copytree(made, tmp_path / "000000"))


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_command(capsys, *arguments)


@pytest.fixture
def refused(run: Run) -> Callable[..., str]:
    """Run an import of PSM1 that must be refused, and give the line on stderr; nothing may be written."""

    def go(folder: Path, *more: object) -> str:
        line = run("import", folder, "--out", "session", *(more or ("--arm", "PSM1"))).refusal
        assert not Path("session").exists()
        return line

    return go


# import


@pytest.mark.parametrize("arm", ARMS)
def test_labels_and_boxes_of_the_arm_are_kept(run: Run, made: Path, arms: MadeArms, arm: str) -> None:
    run("import", made, "--arm", arm, "--out", "session")
    found = read_detections("session/markers.csv")
    assert list(found["000000"]) == [str(number) for number in NUMBERS[arm]]
    assert list(found["000001"]) == [str(number) for number in NUMBERS[arm][:5]]  # the others are null
    for number, pixel in arms.labels[arm][1].items():
        if str(number) in found["000001"]:
            np.testing.assert_allclose(found["000001"][str(number)], pixel, atol=1e-3)
    prompts = read_session("session").frames[1].prompts
    assert prompts is not None
    assert prompts.box is not None
    rows, columns = np.nonzero(arms.coverages(1)[arm] > 0.5)
    assert prompts.box == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)


# refusals


def test_arm_is_asked_for(refused: Callable[..., str], made: Path) -> None:
    assert refused(made, "--side", "left") == (
        f"{made}: --arm: expected the name of the arm to import, for this folder has PSM1, PSM3"
    )
    assert refused(made, "--arm", "PSM2") == f"{made}: --arm: expected one of PSM1, PSM3, got 'PSM2'"


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("api_jp_data.yaml", "{}", ": expected joints by the name of the arm in each frame, got nothing"),
        ("api_jp_data.yaml", "7", ": expected joints by frame (YAML), got 7"),
        ("api_jp_data.yaml", "first: {PSM1: [0, 0, 0.1, 0, 0, 0]}", ": 'first': expected the number of a frame"),
        (
            "api_jp_data.yaml",
            "0: {PSM1: [0, 0, 0.1, 0]}",
            ": frame 0: PSM1: expected 6 values (yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw), 1 (jaw) or all "
            "7, got 4",
        ),
        (
            "api_jp_data.yaml",
            "0: {PSM1: [0, 0, 120, 0, 0, 0]}",
            ": frame 0: PSM1: insertion: expected metres, got 120: this looks like millimetres",
        ),
        ("keypoints_left.yaml", "0: {1: [5]}", ": frame 0: label 1: expected [x, y] in pixels or null, got [5]"),
        ("keypoints_left.yaml", "0: {15: [5, 6]}", ": frame 0: expected numbers of labels, 1 to 14, got 15"),
        ("keypoints_left.yaml", "0: {1: [.nan, 6]}", "label 1: expected [x, y] in pixels or null, got [nan, 6]"),
        (
            "bbox_left.json",
            '{"0": {"1": [1, 2, 3]}}',
            ": frame 0: box '1': expected [x, y, width, height] in pixels or null, got [1, 2, 3]",
        ),
        ("StereoCalibrationDVRK.ini", "[StereoRight]\n", ": StereoLeft: expected this section, got StereoRight"),
        ("StereoCalibrationDVRK.ini", "fc_x = 4", "expected a calibration of a stereo endoscope"),
        (
            "StereoCalibrationDVRK.ini",
            calibration_ini(fc_y=None),
            ": StereoLeft: fc_y: expected a finite number, got nothing",
        ),
        (
            "StereoCalibrationDVRK.ini",
            calibration_ini(kc_1="much"),
            ": StereoLeft: kc_1: expected a finite number, got 'much'",
        ),
        (
            "StereoCalibrationDVRK.ini",
            calibration_ini(res_x="wide"),
            ": StereoLeft: res_x: expected a positive whole number of pixels, got 'wide'",
        ),
    ],
)
def test_wrong_files_are_refused(
    refused: Callable[..., str], folder: Path, file: str, text: str, expected: str
) -> None:
    (folder / file).write_text(text, encoding="utf-8")
    line = refused(folder)
    assert line.startswith(f"{folder / file}: ")
    assert expected in line


def test_wrong_distance_of_the_eyes_is_refused(refused: Callable[..., str], folder: Path) -> None:
    (folder / "StereoCalibrationDVRK.ini").write_text(calibration_ini(T_0=-530.0), encoding="utf-8")
    line = refused(folder, "--arm", "PSM1", "--side", "both")
    assert "StereoRight: R and T: expected 0.0005 to 0.5 m between the cameras, got 530 m or mm" in line


def test_video_of_another_rate_is_refused(refused: Callable[..., str], arms: MadeArms, tmp_path: Path) -> None:
    folder = write_surgpose(
        tmp_path / "60", MadeArms({arm: own[:2] for arm, own in arms.truths.items()}, arms.body), rate=60
    )
    assert refused(folder) == (
        f"{folder}/regular/left_video.mp4: expected 30 images a second, which labels and readings count, got 60; "
        "convert it to 30 first"
    )


# labels


def write_truth(path: Path, arms: MadeArms, arm: str, aside_px: float = 0.0) -> None:
    """Write the true poses of an arm as golden.json, moved so that they are aside in the image."""
    frames = {}
    for k, truth in enumerate(arms.truths[arm]):
        pose = truth.camera_from_root.copy()
        pose[0, 3] += aside_px * pose[2, 3] / CAMERA.fx
        frames[f"{k:06d}"] = {"T_camera_roll_link": pose.tolist(), "joints": dict(truth.joints)}
    write_json(path, {"frames": frames})


@pytest.mark.parametrize("arm", ARMS)
def test_true_poses_have_no_errors_at_the_labels(run: Run, made: Path, arms: MadeArms, arm: str) -> None:
    run("import", made, "--arm", arm, "--out", "session")
    write_truth(Path("golden.json"), arms, arm)
    labels = run("compare", "golden.json", "--labels", "session", "--json").result["labels"]
    names = [str(number) for number in NUMBERS[arm]]
    assert (labels["used"], labels["left_out"]) == (names[:5], names[5:])
    found = labels["sets"][0]
    assert (found["frames"], found["points"], found["without"]) == (FRAMES, 5 * FRAMES, [])
    assert found["px"]["largest"] < 0.005
    printed = run("compare", "golden.json", "--labels", "session").out
    assert f"  used: {', '.join(names[:5])}\n" in printed
    assert f"  left out, for the table has no point of them: {', '.join(names[5:])}\n" in printed


def test_labels_without_any_point_are_refused(run: Run, made: Path, arms: MadeArms) -> None:
    run("import", made, "--arm", "PSM1", "--out", "session")
    write_truth(Path("golden.json"), arms, "PSM1")
    Path("session/markers.csv").write_text("frame,marker,u,v\n000000,6,10,20\n", encoding="utf-8")
    refusal = run("compare", "golden.json", "--labels", "session").refusal
    assert "expected points of labels in session/markers.csv, got no 6" in refusal


def test_points_of_the_table_lie_along_the_tool_as_the_labels_of_the_set(shared: Path) -> None:
    """On the line from the yaw axis (3) to the middle of the tips (4, 5); 6 and 7 are not at the jaws."""
    with (shared / "formats" / "surgpose_labels_example.csv").open(newline="", encoding="utf-8") as file:
        rows = [[float(cell) for cell in row[3:]] for row in list(csv.reader(file))[4:]]
    pixels = np.array(rows).reshape(len(rows), 2, 7, 2).reshape(-1, 7, 2)
    whole = pixels[(pixels != 0).all(axis=(1, 2))]
    axis = whole[:, 3:5].mean(axis=1) - whole[:, 2]
    away = whole - whole[:, 2:3]
    labels = np.median(np.einsum("nkc,nc->nk", away, axis) / (axis**2).sum(axis=1)[:, None], axis=0)
    assert (labels[5:] < -0.5).all()
    table = read_marker_table(bundled_path("markers", "surgpose.json"))
    assert not {"6", "7", "13", "14"} & {*table}
    instrument = prepare("lnd").instrument
    placed = place_markers(instrument, np.zeros(len(instrument.joint_names)), table)
    for numbers in NUMBERS.values():
        yaw, *tips = (placed[str(numbers[k])] for k in (2, 3, 4))
        line = np.mean(tips, axis=0) - yaw
        for number in numbers[:5]:
            along = (placed[str(number)] - yaw) @ line / (line @ line)
            assert along == pytest.approx(labels[number - numbers[0]], abs=0.6)


def test_labels_of_other_frames_are_refused(run: Run, made: Path, arms: MadeArms) -> None:
    run("import", made, "--arm", "PSM1", "--out", "session")
    write_truth(Path("golden.json"), arms, "PSM1")
    document = json.loads(Path("golden.json").read_text())
    write_json("golden.json", {"frames": {"other": document["frames"]["000000"]}})
    refusal = run("compare", "golden.json", "--labels", "session").refusal
    assert refusal.startswith("golden.json: expected frames that session/markers.csv has labels of (000000")


def test_points_need_labels(run: Run) -> None:
    assert run("compare", "a", "b", "--points", "c").refusal == "--points: expected --labels SESSION with it, got none"


@pytest.mark.parametrize("arm", ARMS)
def test_box_in_the_left_eye_chooses_the_arm_in_the_right_one(run: Run, made: Path, arms: MadeArms, arm: str) -> None:
    run("import", made, "--arm", arm, "--side", "both", "--out", "session")
    session = read_session("session")
    settings = SegmentSettings()
    found = segment_task(prepare("lnd"), EstimateConfig(), session.frames[4], rig=session.rig, settings=settings)
    assert found is not None
    for view, right in zip(found.views, (False, True), strict=True):
        true = arms.coverages(4, right)[arm] > 0.5
        assert (view.mask & true).sum() > 0.95 * (view.mask | true).sum()


@pytest.mark.usefixtures("tasks_here")
def test_arm_is_followed_to_about_a_pixel(run: Run, made: Path) -> None:
    """The arm is the one in the boxes; its image is the only evidence."""
    run("import", made, "--arm", "PSM3", "--side", "both", "--out", "session")
    assert run("track", "session", "--no-video", "--no-page").code in (0, 3)
    ran = run("compare", "session/tracks", "--labels", "session", "--json")
    found = ran.result["labels"]["sets"][0]
    assert found["frames"] == FRAMES
    assert found["px"]["mean"] < 1.2
    with open("session/tracks/tracks.csv", newline="", encoding="utf-8") as file:
        statuses = [row["status"] for row in csv.DictReader(file)]
    assert {*statuses} <= {"ok", "doubtful"}  # so few images hardly tell the base
