"""Sessions solved together against the truth: base, offsets, lag, frames left out, wrong cameras, several arms."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dvrk_cmaes import InputError, estimate, read_calibration, read_frame, read_session
from promises.program import DEMO, EASY, EYES, QUICK, TOOLS, Kept, Ran, run
from promises.truth import calibration_in, distance, matrix, median, results, tip_errors, true_base, truth


def deviations(folder: Path, session: Path, arm: str = "") -> np.ndarray:
    """Give the error of the base (6,) in its stated standard deviations: along and about its own axes."""
    document = calibration_in(folder)
    off = np.linalg.inv(matrix(document, "camera_from_base")) @ true_base(session, arm)
    turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
    std = document["std"]
    moved = off[:3, 3] * 1e3 / std["base_translation_mm"]
    return np.concatenate([moved, np.degrees(turn) / std["base_rotation_deg"]])


def test_base_and_offsets_are_found_with_their_stated_errors(kept: Kept) -> None:
    session = kept.synth(*EASY)
    ran = kept("calibrate", session)
    document = calibration_in(ran.folder)
    assert (ran.code, document["status"], document["doubts"]) == (0, "ok", [])
    assert np.abs(deviations(ran.folder, session)).max() < 3.5
    assert distance(matrix(document, "camera_from_base"), true_base(session)) < (4.0, 2.0)
    true = truth(session)
    for joint, offset in document["offsets"].items():
        read = {files.name: files.readings[joint] for files in read_session(session).frames}
        expected = median([true[frame]["joints"][joint] - value for frame, value in read.items()])
        assert abs(offset - expected) < 3.5 * document["std"]["offsets"][joint], joint
    assert document["frames"] == list(true)
    assert document["lag"] is None  # postures, without times


def test_frames_solved_together_are_within_their_stated_errors(kept: Kept) -> None:
    session = kept.synth(*EASY)
    together = kept("calibrate", session).folder
    true, found = truth(session), results(together)
    errors = np.array([tip_errors(result, true[frame]) for frame, result in found.items()])
    assert median(errors.mean(axis=1)) < 0.5
    assert np.mean([result["std"]["tip_90_mm"] for result in found.values()] >= errors.T) >= 0.75
    assert {result["source"] for result in found.values()} == {"session"}
    for frame, one in calibration_in(together)["leave_one_out"].items():
        assert one["iou"] > 0.85, frame


def test_frames_solved_together_are_nearer_to_the_truth_than_alone(kept: Kept, request: pytest.FixtureRequest) -> None:
    easy, tools = kept.synth(*EASY), kept.synth(*TOOLS)
    worlds = [(easy, "", kept("calibrate", easy).folder)]
    request.getfixturevalue("search_short")  # from here on, as in other tests of the two arms
    worlds += [(tools, arm, kept("calibrate", tools).folder / arm) for arm in ("PSM1", "PSM2")]

    def error(of: str) -> float:
        squares = [
            tip_errors(result, truth(session, arm)[frame]) ** 2
            for session, arm, folder in worlds
            for frame, result in results(folder / of).items()
        ]
        return float(np.sqrt(np.mean(squares)))

    assert error("") < error("alone")


def calibrated(folder: Path, *options: object) -> tuple[Ran, Any]:
    """Calibrate ``session`` of a folder; gives what is printed, and the document."""
    ran = run("calibrate", folder / "session", "--out", folder / "out", "--workers", 1, *options)
    return ran, calibration_in(folder / "out")


def test_wrong_frame_is_left_out_by_name_and_the_base_stays(kept: Kept, tmp_path: Path) -> None:
    shutil.copytree(kept.synth(*EASY), tmp_path / "session")
    masks = tmp_path / "session" / "masks"
    shutil.copy(masks / "0001.png", masks / "0006.png")  # another moment's mask
    ran, document = calibrated(tmp_path, "--config", kept.quick)
    assert list(document["left_out"]) == ["0006"]
    assert document["left_out"]["0006"]
    assert "0006" in ran.out
    assert np.abs(deviations(tmp_path / "out", tmp_path / "session")).max() < 3.5


@pytest.mark.parametrize(
    ("pattern", "other", "expected"),
    [
        (r"\b163(\.0)?\b", "213.0", r"a principal point \d+ px \(std \d+\) left"),
        (r"5(21\.3|19(\.0)?)\b", r"4\1", r"a focal length [12]\d\.\d % \(std [\d.]+\) longer"),
    ],
)
def test_wrong_camera_is_doubted_and_so_is_all_that_rests_on_it(
    kept: Kept, tmp_path: Path, pattern: str, other: str, expected: str
) -> None:
    """The centre of another image, or another zoom."""
    shutil.copytree(kept.synth(*EASY), tmp_path / "session")
    camera = tmp_path / "session" / "camera.yaml"
    text, count = re.subn(pattern, other, camera.read_text())
    assert count > 0
    camera.write_text(text)
    settings = tmp_path / "tested.toml"
    settings.write_text(QUICK.replace("false", "true"))
    ran, document = calibrated(tmp_path, "--config", settings)
    assert (ran.code, document["status"]) == (3, "doubtful")
    (doubt,) = [doubt for doubt in document["doubts"] if "camera file is contradicted" in doubt]
    assert re.search(expected, doubt), doubt
    for result in results(tmp_path / "out").values():
        assert result["status"] == "doubtful"
        assert any(reason.startswith("session: ") for reason in result["reasons"])


def test_calibration_is_used_by_later_commands_and_in_python(kept: Kept, tmp_path: Path) -> None:
    session = kept.synth(*EASY)
    folder = kept("calibrate", session).folder
    words = ("--session", folder / "session.json", "--frames", "000[0-2]", "--workers", 1, "--out", tmp_path / "out")
    assert run("batch", session, *words).code == 0
    true, found = truth(session), results(tmp_path / "out")
    for frame, result in found.items():
        assert result["source"] == "session"
        assert result["evaluations"] < results(folder / "alone")[frame]["evaluations"]
        assert tip_errors(result, true[frame]).max() < 1.0
        expected = matrix(calibration_in(folder), "camera_from_base")
        assert distance(matrix(result, "camera_from_base"), expected) < (4.0, 4.0)  # with this frame's readings
    read = read_session(session)
    data, calibration = read_frame(read.frames[2], read.camera), read_calibration(folder / "session.json")
    result = estimate(data.mask, data.camera, dict(read.frames[2].readings), "lnd", session=calibration)
    assert tip_errors(result.to_dict(), true["0002"]).max() < 1.0


def test_calibration_is_read_and_written_in_python(kept: Kept) -> None:
    path = kept("calibrate", kept.synth(*EASY)).folder / "session.json"
    calibration = read_calibration(path)
    document = json.loads(path.read_text())
    np.testing.assert_allclose(calibration.camera_from_base, matrix(document, "camera_from_base"), atol=1e-12)
    again = json.loads(json.dumps(calibration.to_dict()))
    assert {**again, "std": None} == {**document, "std": None}
    assert again["std"]["base_rotation_deg"] == pytest.approx(document["std"]["base_rotation_deg"], rel=1e-4)


@pytest.mark.usefixtures("search_short")
def test_two_arms_are_calibrated_each_and_to_each_other(kept: Kept) -> None:
    session = kept.synth(*TOOLS)
    out = kept("calibrate", session).folder
    for arm in ("PSM1", "PSM2"):
        assert np.abs(deviations(out / arm, session, arm)).max() < 4
    arms = json.loads((out / "arms.json").read_text())
    found = matrix(arms["arms"]["PSM2"], "reference_from_base")
    expected = np.linalg.inv(true_base(session, arms["reference"])) @ true_base(session, "PSM2")
    assert distance(found, expected) < (8.0, 4.0)


def test_both_eyes_are_calibrated_and_drawn_beside_each_other(kept: Kept) -> None:
    session = kept.synth(*EYES)
    out = kept("calibrate", session).folder
    assert np.abs(deviations(out, session)).max() < 3.5
    document = calibration_in(out)
    assert document["left_out"] == {}
    for result in results(out).values():
        assert [one["name"] for one in result["view_fits"]] == ["left", "right"]
    for folder in ("overlays", "overlays_left_out"):
        picture = cv2.imread(str(out / folder / "0001.jpg"))
        assert picture is not None
        assert picture.shape[1] > 2 * picture.shape[0]  # one eye is 4 : 3, below a header


def test_session_without_outer_joints_cannot_be_calibrated(tmp_path: Path) -> None:
    shutil.copytree(DEMO, tmp_path / "session")
    rows = [line.split(",") for line in (DEMO / "joints.csv").read_text().splitlines()]
    columns = [k for k, name in enumerate(rows[0]) if name not in ("yaw", "pitch", "insertion", "roll")]
    text = "\n".join(",".join(row[k] for k in columns) for row in rows)
    (tmp_path / "session" / "joints.csv").write_text(text + "\n")
    assert "yaw" in run("calibrate", tmp_path / "session", "--out", tmp_path / "out").refusal
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
    document = inner = calibration_in(kept("calibrate", kept.synth(*EASY)).folder)
    *outer, name = place.split(".")
    for key in outer:
        inner = inner[key]
    inner[name] = value
    path = tmp_path / "session.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as caught:
        read_calibration(path)
    assert str(caught.value).startswith(f"{path}: {expected}")


def test_frame_fails_by_a_calibration_of_other_joints(kept: Kept, tmp_path: Path) -> None:
    session = kept.synth(*EASY)
    text = (kept("calibrate", session).folder / "session.json").read_text()
    (tmp_path / "session.json").write_text(text.replace("wrist_pitch", "elbow"))
    words = ("--session", tmp_path / "session.json", "--frames", "0000", "--out", tmp_path / "out", "--workers", 1)
    assert run("batch", session, *words).code == 1
    (reason,) = results(tmp_path / "out")["0000"]["reasons"]
    assert reason.startswith("session: offsets: expected those of insertion, roll, wrist_pitch"), reason
