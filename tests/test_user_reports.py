"""Small inputs made after public bug reports of users (``../shared/reports``): each is read with the right value."""

from __future__ import annotations

import csv
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.canned_results import canned
from helpers.commands import Ran, run_command
from helpers.made_recordings import write_video
from helpers.places import bundled_path
from helpers.readings import read_joints

from dvrk_cmaes import EstimateConfig, FrameData, InputError, ReadingSeries, SessionFrame, load_instrument, read_session
from dvrk_cmaes.calibration.lag import SessionLag
from dvrk_cmaes.calibration.session_loop import started
from dvrk_cmaes.calibration.session_problem import ArmSession, ArmSetup
from dvrk_cmaes.camera.files import read_camera_file
from dvrk_cmaes.camera.rig_files import read_rig
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.truth import read_golden
from dvrk_cmaes.joints.reading import read_joint_file
from dvrk_cmaes.joints.rows import ReadAs

Run = Callable[..., Ran]
Table = list[dict[str, str]]


@pytest.fixture
def reports(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give the folder of the reports; the working folder is an empty one."""
    monkeypatch.chdir(tmp_path)
    return shared / "reports"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    return partial(run_command, capsys)


def rows(path: str) -> Table:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def imported(run: Run, recording: Path, *more: object) -> list[str]:
    """Import a recording to ``session``; give the notes."""
    done = run("import", recording, "--out", "session", "--json", *more)
    assert done.code == 0
    notes: list[str] = done.result["notes"]
    return notes


@pytest.mark.parametrize("name", ["mixed.yaml", "psm1_first.yaml", "two_arms.csv"])
def test_joints_of_two_arms_are_those_of_the_arm_that_is_asked_for(reports: Path, run: Run, name: str) -> None:
    path = reports / "joints-two-arms" / name
    with pytest.raises(InputError, match=r"expected the joints of one arm, got those of PSM1, PSM2: .*--only PSM1"):
        read_joint_file(path)
    own = {arm: read_joint_file(path, read_as=ReadAs(arm)).readings(-1) for arm in ("PSM1", "PSM2")}
    assert own["PSM2"] == dict.fromkeys(own["PSM2"], 0.1)
    assert len(own["PSM1"]) == 7
    if name.endswith(".yaml"):
        assert own["PSM1"]["pitch"] == -0.111204
        assert own["PSM1"]["roll"] == -1.649538
    demo = bundled_path("demo")
    frame = ("--mask", demo / "masks" / "0001.png", "--camera", demo / "camera.yaml", "--joints", path)
    assert "--only" in run("estimate", *frame).refusal


def test_stamps_that_stand_still_are_those_of_recording(reports: Path, run: Run) -> None:
    notes = imported(run, reports / "bag-stamps-stand-still" / "rec.bag")
    assert any("times: those of recording" in note and "do not advance" in note for note in notes)
    readings = [row["wrist_yaw"] for row in rows("session/joints.csv")]
    assert len(set(readings)) == 8


def test_two_frames_of_one_time_count_as_one_moment(reports: Path, run: Run) -> None:
    session = read_session(reports / "time-twice")
    times = np.array([frame.time for frame in session.frames], np.float64)
    assert len(set(times.tolist())) < len(times)
    Path("quick.toml").write_text("[search]\nsamples = 64\nstarts = 1\nevaluations = 60\n")
    options = ("--no-video", "--no-page", "--causal", "--config", "quick.toml")
    done = run("track", reports / "time-twice", "--out", "tracks", *options)
    assert "left out, for they have the time of the frame before: 0024" in done.err
    assert [row["frame"] for row in rows("tracks/tracks.csv")] == [f"{k:04d}" for k in (0, 6, 12, 18, 30, 36, 42)]


@pytest.mark.parametrize("causal", [(), ("--causal",)])
def test_time_that_goes_back_is_refused_at_the_start(reports: Path, run: Run, causal: tuple[str, ...]) -> None:
    refusal = run("track", reports / "time-jumps-back", "--out", "tracks", *causal).refusal
    assert "joints.csv: frame 0024: expected a later time than that of frame 0022" in refusal
    assert not Path("tracks").exists()


def test_both_camera_infos_may_name_the_left_frame(reports: Path) -> None:
    folder = reports / "rig-same-frame"
    same, own = (read_rig(folder / f"left_{kind}.yaml", folder / f"right_{kind}.yaml").rig for kind in ("same", "own"))
    np.testing.assert_array_equal(same.views[1].view_from_camera, own.views[1].view_from_camera)


def test_messages_without_joints_are_skipped_and_counted(reports: Path, run: Run) -> None:
    notes = imported(run, reports / "bag-empty-first" / "jaw.bag")
    assert "/PSM1/jaw/measured_js: 2 messages without positions skipped" in notes
    assert [row["jaw"] == "" for row in rows("session/joints.csv")] == [True, True, False, False, False, False]
    folder = reports / "joints-first-message-empty"
    for name, count in (("first_empty.yaml", 6), ("jaw_first_empty.yaml", 1)):
        file = read_joint_file(folder / name)
        assert "1 message without positions skipped" in file.notes
        assert file.values.shape == (2, count)
    assert read_joints(folder / "jaw.yaml") == {"jaw": 0.835055}


def test_packed_colours_are_read_under_their_new_names(reports: Path, run: Run) -> None:
    imported(run, reports / "bag-encodings" / "yuyv.bag")
    assert len(list(Path("session", "images").iterdir())) == 3


def test_camera_messages_of_rectified_images_are_read(reports: Path, run: Run) -> None:
    for name in ("k_zero.bag", "model_none.bag"):
        imported(run, reports / "bag-camera-info" / name, "--overwrite")
        lens = read_camera_file("session/camera.yaml")
        assert lens.camera.is_pinhole
        assert (lens.camera.width, lens.camera.height) == (400, 300)
        assert lens.camera.fx > 100


def test_reindexed_recording_is_read_by_its_suffix(reports: Path, run: Run) -> None:
    imported(run, reports / "bag-reindexed" / "rec_mcap")
    assert len(rows("session/joints.csv")) == 4


def test_session_whose_name_ends_in_bag_is_a_session(reports: Path, run: Run) -> None:
    session = Path("rec.bag")
    (session / "masks").mkdir(parents=True)
    demo = bundled_path("demo")
    for name in ("camera.yaml", "joints.csv"):
        shutil.copy(demo / name, session / name)
    shutil.copy(demo / "masks" / "0001.png", session / "masks" / "0001.png")
    done = run("track", session, "--out", "tracks", "--no-video", "--no-page", "--causal")
    assert done.code in (0, 3)
    assert [row["frame"] for row in rows("tracks/tracks.csv")] == ["0001"]


def test_jaw_of_surgpose_is_read(reports: Path, run: Run) -> None:
    notes = imported(run, reports / "surgpose-jaw" / "SurgPose" / "000000", "--arm", "PSM1", "--side", "both")
    assert "jaw: gripper_angle.yaml, PSM1" in notes
    assert [float(row["jaw"]) for row in rows("session/joints.csv")][:2] == [0.570412, 0.59326]


def test_camera_file_with_the_directive_of_yaml_1_0_is_read(reports: Path) -> None:
    assert read_camera_file(reports / "cam-yaml10-header" / "yaml10_space.yaml").camera.fx == 1042.6


def frames_and_series(folder: Path, later: float = 0.0) -> tuple[list[SessionFrame], ReadingSeries | None]:
    """Give every twelfth frame of a recording with its true pose, and all readings; images are ``later`` by some s."""
    session, truth = read_session(folder), read_golden(folder / "golden.json")
    covariance = np.diag([2e-4] * 3 + [0.01] * 6) ** 2
    frames = []
    for files in session.frames[::12]:
        own = truth.frames[files.name]
        joints = {name: own.joints[name] for name in ("wrist_pitch", "wrist_yaw", "jaw")}
        pose = own.camera_from_root
        result = canned(
            files.name, camera_from_root=pose, joints=joints, readings=files.readings, covariance=covariance
        )
        frames.append(SessionFrame(files.name, FrameData(()), result))
    times = {files.name: round(((files.time or 0.0) + later) * 1e9) for files in session.frames}
    return frames, ReadingSeries.of_files(session.joint_files, times)


def lag_of(frames: list[SessionFrame], series: ReadingSeries | None) -> SessionLag:
    """Give what the frames' own poses tell of the lag."""
    setup = ArmSetup(series, load_instrument("lnd"), "classic", EstimateConfig(), lambda function, tasks: [])
    return started([ArmSession.of(setup, frames)])[0].lag


def test_lag_of_two_seconds_is_found(reports: Path) -> None:
    frames, series = frames_and_series(reports / "lag-beyond-range")
    lag = lag_of(frames, series).lag
    assert lag is not None
    assert lag.applied
    assert lag.seconds == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("later", [1.6, -6.0])
def test_lag_beyond_the_range_is_not_found(reports: Path, later: float) -> None:
    frames, series = frames_and_series(reports / "lag-beyond-range", later)
    found = lag_of(frames, series)
    assert found.lag is None
    assert "not determined in the range searched, -3 to +3 s" in found.undetermined
    assert "beyond" in found.undetermined


@pytest.mark.parametrize(
    ("name", "label", "joints"),
    [
        ("nan.csv", "0001", 5),
        ("na.csv", "0001", 6),
        ("none.csv", "0001", 6),
        ("nan_first.yaml", None, 0),
        ("nan_one.yaml", None, 6),
    ],
)
def test_reading_that_is_written_as_missing_is_not_known(
    reports: Path, name: str, label: str | None, joints: int
) -> None:
    file = read_joint_file(reports / "joints-nan" / name)
    assert len(file.readings(0 if label is None else file.names[label])) == joints


def test_frames_whose_readings_are_all_missing_count_as_without(reports: Path, run: Run) -> None:
    done = run("import", reports / "joints-nan" / "nan_first.bag", "--out", "session", "--json")
    of_arm = next(source for source in done.result["readings"] if "yaw" in source["joints"])
    assert (of_arm["frames"], of_arm["without"]) == (2, 2)


@pytest.mark.parametrize(
    ("name", "times", "expected"),
    [
        ("excel", None, "got 1 different ones in 25 rows, such as 1.70E+09: digits were lost"),
        ("float32", None, "got 1 different ones in 25 rows, such as 1700000000.000: digits were lost"),
        ("to the second", [f"{1.7e9 + k // 10:.0f}.0" for k in range(30)], "got 3 different ones in 30 rows"),
        (
            "in ms, as a float",
            [f"{1.7e12:.3e}" for _ in range(30)],
            "got 1 different ones in 30 rows, such as 1.70",
        ),
    ],
)
def test_times_that_lost_their_digits_are_named(
    reports: Path, tmp_path: Path, name: str, times: list[str] | None, expected: str
) -> None:
    path = reports / "time-lost-digits" / f"{name}.csv"
    if times is not None:
        path = tmp_path / "joints.csv"
        path.write_text("time,jaw\n" + "".join(f"{time},0.5\n" for time in times))
    with pytest.raises(InputError, match=re.escape(expected)):
        read_joint_file(path)


def test_readings_of_another_clock_name_both_and_the_option(reports: Path, run: Run) -> None:
    video, demo = write_video(Path("video.avi")), bundled_path("demo")
    epoch = reports / "time-lost-digits" / "epoch.csv"
    refusal = run("import", video, "--camera", demo / "camera.yaml", "--joints", epoch, "--out", "session").refusal
    assert "got readings of 1700000000.000 to 1700000000.480 s and images of 0.000 to" in refusal
    assert "--video-start" in refusal


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("cvat_mask.xml", None, "CVAT's XML: export as COCO"),
        ("cvat_poly.xml", None, "CVAT's XML: export as COCO"),
        ("0001.txt", None, "YOLO's polygons: export as COCO"),
        ("0001.tif", None, "a TIFF: save it as PNG"),
        ("sam2.npz", None, "a NumPy array or an archive"),
        ("labelstudio.json", None, "Label Studio's JSON: export as COCO"),
        ("labelstudio_poly.json", None, "Label Studio's JSON: export as COCO"),
        ("m.npy", b"\x93NUMPY\x01\0", "a NumPy array or an archive"),
        ("m.webp", b"RIFF\x10\0\0\0WEBPVP8 ", "a WebP: save it as PNG"),
        ("m.nrrd", b"NRRD0004\n", "a volume of slices"),
        ("m.bmp", b"BM\x10\0", "a BMP: save it as PNG"),
        ("m.txt", b"1 0.5 0.25 0.6 0.25 0.6 0.5\n", "YOLO's polygons: export as COCO"),
    ],
)
def test_files_of_annotators_name_what_to_export(
    reports: Path, tmp_path: Path, name: str, data: bytes | None, expected: str
) -> None:
    path = reports / "mask-annotators" / name
    if data is not None:
        path = tmp_path / name
        path.write_bytes(data)
    with pytest.raises(InputError, match=re.escape(expected)):
        read_mask(path)


@pytest.mark.parametrize("place", ["labels/0001.txt", "annotations.xml", "masks/0001.tif", "masks/0001.npy"])
def test_session_does_not_pass_over_the_files_of_an_annotator(reports: Path, tmp_path: Path, place: str) -> None:
    for folder in ("images", "labels", "masks"):
        (tmp_path / folder).mkdir()
    shutil.copy(bundled_path("demo", "camera.yaml"), tmp_path)
    shutil.copy(bundled_path("demo", "masks", "0001.png"), tmp_path / "images")
    given = {"txt": "0001.txt", "xml": "cvat_mask.xml", "tif": "0001.tif", "npy": "sam2.npz"}[place.split(".")[1]]
    shutil.copy(reports / "mask-annotators" / given, tmp_path / place)
    with pytest.raises(InputError, match=rf"{place}: expected masks .*, got "):
        read_session(tmp_path, joints=None)


@pytest.mark.parametrize("name", ["rec.bag.active", "cut.bag", "cut.mcap"])
def test_recording_that_was_cut_off_names_what_mends_it(reports: Path, run: Run, name: str) -> None:
    whole = {"bag": "bag-stamps-stand-still/rec.bag", "mcap": "bag-reindexed/rec_mcap/rec_mcap.mcap"}
    source = reports / whole.get(name.split(".")[-1], whole["bag"])
    Path(name).write_bytes(source.read_bytes()[:3000])
    refusal = run("import", name, "--out", "session").refusal
    assert "reindex" in refusal
    assert ("recover" in refusal) == (name != "rec.bag.active")


def test_masks_that_meet_no_image_are_refused_and_those_of_tasks_are_paired_in_order(reports: Path) -> None:
    with pytest.raises(InputError, match=r"masks: expected masks .*"):
        read_session(reports / "names-do-not-meet" / "sam2_obj")
    session = read_session(reports / "names-do-not-meet" / "ls_png")
    assert [frame.mask.name[:6] for frame in session.frames if frame.mask] == ["task-1", "task-2"]
    assert session.warnings[0].startswith("paired in order")


def test_masks_of_a_data_set_meet_the_images(reports: Path) -> None:
    session = read_session(reports / "names-do-not-meet" / "roboflow")
    assert [frame.name for frame in session.frames] == ["0000", "0001"]
    assert all(frame.image and frame.readings for frame in session.frames)
    assert all(read_frame(frame, session.camera).mask.any() for frame in session.frames)
