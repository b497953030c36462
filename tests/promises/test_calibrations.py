"""Sessions solved together against the truth: base, offsets, lag, frames left out, wrong cameras, several arms."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes import InputError, read_calibration, read_session
from promises.program import DEMO, OUT, Kept, distance, matrix, median, results, run, synth, tip_errors, truth

EASY = ("--level", "easy", "--frames", 8, "--seed", 5, "--no-images")
EYES = ("--stereo", "--level", "medium", "--frames", 4, "--seed", 2, "--no-images")
TOOLS = ("--arms", 2, "--level", "easy", "--frames", 4, "--seed", 3, "--no-images")


def base(session: Path, arm: str = "") -> np.ndarray:
    """Give the true base of an arm in the camera."""
    name = f"golden_{arm}.json" if arm else "golden.json"
    return matrix(json.loads((session / name).read_text()), "camera_from_base")


def deviations(calibration: Path, session: Path, arm: str = "") -> np.ndarray:
    """Give the error of the base (6,) in its stated standard deviations: along and about its own axes."""
    document = json.loads(calibration.read_text())
    off = np.linalg.inv(matrix(document, "camera_from_base")) @ base(session, arm)
    turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
    std = document["std"]
    moved = off[:3, 3] * 1e3 / std["base_translation_mm"]
    return np.concatenate([moved, np.degrees(turn) / std["base_rotation_deg"]])


def test_base_and_offsets_are_found_with_their_stated_errors(kept: Kept) -> None:
    session = synth(kept, *EASY)
    ran = kept("calibrate", session, "--out", OUT)
    document = json.loads((ran.folder / "session.json").read_text())
    assert (ran.code, document["status"], document["doubts"]) == (0, "ok", [])
    assert np.abs(deviations(ran.folder / "session.json", session)).max() < 3.5
    assert distance(matrix(document, "camera_from_base"), base(session)) < (4.0, 2.0)
    true = truth(session)
    for joint, offset in document["offsets"].items():
        read = {files.name: files.readings[joint] for files in read_session(session).frames}
        expected = median([true[frame]["joints"][joint] - value for frame, value in read.items()])
        assert abs(offset - expected) < 3.5 * document["std"]["offsets"][joint], joint
    assert document["frames"] == list(true)
    assert document["lag"] is None  # postures, without times


def test_frames_solved_together_are_nearer_to_the_truth_than_alone(kept: Kept) -> None:
    session = synth(kept, *EASY)
    together = kept("calibrate", session, "--out", OUT).folder
    true = truth(session)
    errors = {
        folder: [tip_errors(result, true[frame]).mean() for frame, result in results(folder).items()]
        for folder in (together, together / "alone")
    }
    assert median(errors[together]) < min(0.5, 1.1 * median(errors[together / "alone"]))
    within = [
        tip_errors(result, true[frame]) <= result["std"]["tip_90_mm"] for frame, result in results(together).items()
    ]
    assert np.mean(within) >= 0.75
    assert {result["source"] for result in results(together).values()} == {"session"}
    for frame, one in json.loads((together / "session.json").read_text())["leave_one_out"].items():
        assert one["iou"] > 0.85, frame


def test_wrong_frame_is_left_out_by_name_and_the_base_stays(kept: Kept, tmp_path: Path) -> None:
    shutil.copytree(synth(kept, *EASY), tmp_path / "session")
    masks = tmp_path / "session" / "masks"
    shutil.copy(masks / "0001.png", masks / "0006.png")  # another moment's mask
    ran = run("calibrate", tmp_path / "session", "--out", tmp_path / "out", "--workers", 1)
    document = json.loads((tmp_path / "out" / "session.json").read_text())
    assert list(document["left_out"]) == ["0006"]
    assert document["left_out"]["0006"]
    assert "0006" in ran.out
    assert np.abs(deviations(tmp_path / "out" / "session.json", tmp_path / "session")).max() < 3.5


def with_camera(session: Path, folder: Path, pattern: str, other: str) -> Path:
    """Copy a session with another camera file."""
    shutil.copytree(session, folder)
    text, count = re.subn(pattern, other, (folder / "camera.yaml").read_text())
    assert count > 0
    (folder / "camera.yaml").write_text(text)
    return folder


def test_centre_of_another_image_is_doubted_with_its_direction(kept: Kept, tmp_path: Path, quick: Path) -> None:
    session = with_camera(synth(kept, *EASY), tmp_path / "session", r"\b163(\.0)?\b", "213.0")
    run("calibrate", session, "--out", tmp_path / "out", "--config", quick, "--workers", 1)
    document = json.loads((tmp_path / "out" / "session.json").read_text())
    (doubt,) = [doubt for doubt in document["doubts"] if "camera file is contradicted" in doubt]
    assert re.search(r"a principal point \d+ px \(std \d+\) left", doubt), doubt


def test_camera_of_another_zoom_is_doubted_and_so_is_all_that_rests_on_it(
    kept: Kept, tmp_path: Path, quick: Path
) -> None:
    session = with_camera(synth(kept, *EASY), tmp_path / "session", r"5(21\.3|19(\.0)?)\b", r"4\1")
    ran = run("calibrate", session, "--out", tmp_path / "out", "--config", quick, "--workers", 1)
    document = json.loads((tmp_path / "out" / "session.json").read_text())
    assert (ran.code, document["status"]) == (3, "doubtful")
    assert any("camera file is contradicted" in doubt for doubt in document["doubts"])
    assert document["blocks"]["camera"]["values"][0] > np.log(1.1)
    for result in results(tmp_path / "out").values():
        assert result["status"] == "doubtful"
        assert any(reason.startswith("session: ") for reason in result["reasons"])


def test_calibration_is_used_by_later_commands(kept: Kept, tmp_path: Path) -> None:
    session = synth(kept, *EASY)
    calibrated = kept("calibrate", session, "--out", OUT).folder
    ran = run(
        *("batch", session, "--session", calibrated / "session.json", "--frames", "000[0-2]", "--workers", 1),
        *("--out", tmp_path / "out"),
    )
    assert ran.code == 0
    true = truth(session)
    for frame, result in results(tmp_path / "out").items():
        assert result["source"] == "session"
        assert tip_errors(result, true[frame]).max() < 1.0
        expected = matrix(json.loads((calibrated / "session.json").read_text()), "camera_from_base")
        assert distance(matrix(result, "camera_from_base"), expected) < (4.0, 4.0)  # with this frame's readings


def test_calibration_is_read_and_written_in_python(kept: Kept) -> None:
    path = kept("calibrate", synth(kept, *EASY), "--out", OUT).folder / "session.json"
    calibration = read_calibration(path)
    document = json.loads(path.read_text())
    np.testing.assert_allclose(calibration.camera_from_base, matrix(document, "camera_from_base"), atol=1e-12)
    again = json.loads(json.dumps(calibration.to_dict()))
    assert {**again, "std": None} == {**document, "std": None}
    assert again["std"]["base_rotation_deg"] == pytest.approx(document["std"]["base_rotation_deg"], rel=1e-4)


@pytest.mark.usefixtures("search_short")
def test_two_arms_are_calibrated_each_and_to_each_other(kept: Kept) -> None:
    session = synth(kept, *TOOLS)
    out = kept("calibrate", session, "--out", OUT).folder
    for arm in ("PSM1", "PSM2"):
        assert np.abs(deviations(out / arm / "session.json", session, arm)).max() < 4
    arms = json.loads((out / "arms.json").read_text())
    found = matrix(arms["arms"]["PSM2"], "reference_from_base")
    expected = np.linalg.inv(base(session, arms["reference"])) @ base(session, "PSM2")
    assert distance(found, expected) < (8.0, 4.0)


def test_both_eyes_are_calibrated_and_drawn_beside_each_other(kept: Kept) -> None:
    session = synth(kept, *EYES)
    out = kept("calibrate", session, "--out", OUT).folder
    assert np.abs(deviations(out / "session.json", session)).max() < 3.5
    document = json.loads((out / "session.json").read_text())
    assert document["left_out"] == {}
    for result in results(out).values():
        assert [one["name"] for one in result["view_fits"]] == ["left", "right"]
    for folder in ("overlays", "overlays_left_out"):
        picture = cv2.imread(str(out / folder / "0001.jpg"))
        assert picture is not None
        assert picture.shape[1] > 2 * picture.shape[0]  # one eye is 4 : 3, below a header


def test_session_without_outer_joints_cannot_be_calibrated(tmp_path: Path, quick: Path) -> None:
    shutil.copytree(DEMO, tmp_path / "session")
    rows = [line.split(",") for line in (DEMO / "joints.csv").read_text().splitlines()]
    kept_columns = [k for k, name in enumerate(rows[0]) if name not in ("yaw", "pitch", "insertion", "roll")]
    text = "\n".join(",".join(row[k] for k in kept_columns) for row in rows)
    (tmp_path / "session" / "joints.csv").write_text(text + "\n")
    words = ("calibrate", tmp_path / "session", "--out", tmp_path / "out", "--config", quick, "--workers", 1)
    assert "yaw" in run(*words).refusal
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("place", "value", "expected"),
    [
        ("camera_from_base", None, "camera_from_base: expected 4 rows of 4 finite numbers, got nothing"),
        ("camera_from_base", [[1, 0, 0, 0]] * 4, "camera_from_base: expected a rotation and a translation"),
        ("offsets.jaw", "far", "offsets.jaw: expected a finite number, got 'far'"),
        ("covariance.matrix", [[1.0]], "covariance.matrix: expected 11 rows of 11 finite numbers, no negative"),
        ("covariance.given_camera", [[1.0]], "covariance.given_camera: expected 11 rows of 11 finite numbers"),
        ("covariance.axes", ["tx"], "covariance.axes: expected tx, ty, tz, rx, ry, rz, insertion, roll, wrist_pitch"),
        ("schema", 2, "schema: expected 5, got 2; calibrate again: dvrk-cmaes calibrate FOLDER"),
        ("lag", {"applied": True}, "lag: expected frames or seconds, got {'applied': True}"),
        ("spreads.roll", 0.0, "spreads.roll: expected a number above 0, got 0.0"),
        ("covariance", [], "covariance: expected an object, got []"),
        ("iou", "high", "iou: expected a finite number, got 'high'"),
        ("arm", "xi", "arm: expected one of si, classic, got 'xi'"),
        ("left_out", ["0001"], "left_out: expected an object, got ['0001']"),
        ("leave_one_out.0000", 1, "leave_one_out.0000: expected an object, got 1"),
        ("frames", "0000", "frames: expected a list of texts, got '0000'"),
        ("seed", -1, "seed: expected a whole number of at least 0, got -1"),
        ("config", [1], "config: expected an object, got [1]"),
    ],
)
def test_damaged_calibration_is_refused_by_its_field(
    kept: Kept, tmp_path: Path, place: str, value: object, expected: str
) -> None:
    path = kept("calibrate", synth(kept, *EASY), "--out", OUT).folder / "session.json"
    document = json.loads(path.read_text())
    *outer, name = place.split(".")
    inner = document
    for key in outer:
        inner = inner[key]
    inner[name] = value
    (tmp_path / "session.json").write_text(json.dumps(document))
    with pytest.raises(InputError) as caught:
        read_calibration(tmp_path / "session.json")
    assert str(caught.value).startswith(f"{tmp_path / 'session.json'}: {expected}")


def test_frame_fails_by_a_calibration_of_other_joints(kept: Kept, tmp_path: Path) -> None:
    session = synth(kept, *EASY)
    text = (kept("calibrate", session, "--out", OUT).folder / "session.json").read_text()
    (tmp_path / "session.json").write_text(text.replace("wrist_pitch", "elbow"))
    words = ("--session", tmp_path / "session.json", "--frames", "0000", "--out", tmp_path / "out", "--workers", 1)
    assert run("batch", session, *words).code == 1
    (reason,) = results(tmp_path / "out")["0000"]["reasons"]
    assert reason.startswith("session: offsets: expected those of insertion, roll, wrist_pitch"), reason
