"""Followed recordings against the truth: whole, causal, by images, both eyes, two arms, a steered endoscope."""

from __future__ import annotations

import csv
import json
import shutil
import signal
from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dvrk_cmaes import Tracker, prepare, read_calibration, read_camera, read_session
from promises.program import DEMO, QUICK, Kept, content, run
from promises.truth import calibration_in, distance, matrix, median, tip_errors, tracks, true_base, truth

pytestmark = pytest.mark.usefixtures("searches_short")

VIDEO = ("--motion", "video", "--level", "easy", "--no-images")
ONE = (*VIDEO, "--frames", 32, "--seed", 5, "--lag", "2frames")
STEERED = (*VIDEO, "--frames", 16, "--seed", 7, "--ecm")
PAIR = (*VIDEO, "--frames", 12, "--seed", 3, "--arms", 2, "--stereo")
IMAGES = ("--motion", "video", "--level", "easy", "--frames", 12, "--seed", 8)
POSTURES = ("--level", "easy", "--frames", 14, "--seed", 5)
PLAIN = ("--no-video", "--no-page")


def check(found: Mapping[str, Mapping[str, Any]], true: Mapping[str, Any], *, frames: Iterable[str] = ()) -> float:
    """Check statuses and stated errors of a followed recording; gives the median error of the tips, mm."""
    errors, stated = [], []
    for frame in frames or found:
        row = found[frame]
        assert row["status"] in ("ok", "doubtful", "lost")
        assert bool(row["reasons"]) == (row["status"] != "ok"), row
        if row["camera_from_root"] is None:
            assert row["status"] == "lost"
            continue
        error = tip_errors(row, true[frame])
        if row["status"] == "ok":
            assert error.max() < 3.0, frame  # ok and wrong
        if row["status"] != "lost":
            errors.append(error.max())
            stated.append(row["std"]["tip_mm"])
    assert np.mean(np.array(errors) < 2.0 * np.array(stated)) > 0.8
    return median(errors)


@pytest.fixture
def one(kept: Kept) -> Path:
    """A recording of one arm."""
    return kept.synth(*ONE)


@pytest.fixture
def calibration(kept: Kept, one: Path) -> Path:
    """The calibration with which it was followed."""
    return kept("track", one).folder / "session.json"


def test_recording_is_followed_and_states_its_errors(one: Path, calibration: Path) -> None:
    folder, document = calibration.parent, calibration_in(calibration.parent)
    found, true = tracks(folder), truth(one)
    assert list(found) == list(true)
    assert check(found, true) < 0.3
    assert np.mean([row["status"] == "ok" for row in found.values()]) > 0.9
    lag = document["lag"]
    assert lag["frames"] == pytest.approx(2.0, abs=max(0.5, 3 * lag["std_frames"]))
    assert (lag["applied"], lag["sign"]) == (True, "images late")
    assert distance(matrix(document, "camera_from_base"), true_base(one)) < (8.0, 6.0)
    assert (folder / "report.html").is_file()
    video = cv2.VideoCapture(str(folder / "tracks.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == len(true)
    rows = csv.DictReader((folder / "tracks.csv").read_text().splitlines())
    for named, row in zip(rows, found.values(), strict=True):
        assert (named["frame"], named["status"]) == (row["frame"], row["status"])
        tip = [float(named[f"tip_1_{axis}_mm"]) for axis in "xyz"]
        assert tip == pytest.approx(np.array(row["tips"][0]) * 1e3, abs=1e-3)


def test_no_result_of_a_causal_run_uses_later_frames(kept: Kept, one: Path, tmp_path: Path) -> None:
    whole = tracks(kept("track", one, "--causal", *PLAIN).folder)
    check(whole, truth(one))
    assert not any(row["status"] == "ok" for row in list(whole.values())[:10])  # the base is not known yet
    shutil.copytree(one, tmp_path / "short")
    for path in sorted((tmp_path / "short" / "masks").iterdir())[16:]:
        path.unlink()
    run("track", tmp_path / "short", "--causal", "--out", tmp_path / "out", *PLAIN)
    for frame, row in tracks(tmp_path / "out").items():
        if frame < "0016":
            for key in ("status", "camera_from_root", "joints"):
                assert row[key] == whole[frame][key], (frame, key)


def test_known_calibration_is_used_from_the_first_frame_and_after_a_loss(
    one: Path, calibration: Path, tmp_path: Path
) -> None:
    shutil.copytree(one, tmp_path / "gap")
    lost = [f"{k:04d}" for k in range(16, 22)]
    for frame in lost:
        cv2.imwrite(str(tmp_path / "gap" / "masks" / f"{frame}.png"), np.zeros((240, 320), np.uint8))
    words = ("track", tmp_path / "gap", "--session", calibration, "--causal", *PLAIN)
    first, _ = (run(*words, "--out", tmp_path / name) for name in ("first", "again"))
    found, same = ({k: v | {"seconds": 0} for k, v in tracks(tmp_path / name).items()} for name in ("first", "again"))
    assert found == same
    before, after = [*found][:16], [*found][28:]
    assert check(found, truth(one), frames=before) < 0.3
    assert np.mean([found[frame]["status"] == "ok" for frame in before]) > 0.9
    assert {found[frame]["status"] for frame in lost} == {"lost"}
    assert all(found[frame]["reasons"] for frame in lost)
    assert "6 frames (0016 to 0021)" in first.out
    assert check(found, truth(one), frames=after) < 1.5


def test_images_of_something_else_are_not_ok_and_no_keyframes(kept: Kept, tmp_path: Path) -> None:
    session = kept.synth(*POSTURES)
    shutil.copytree(session, tmp_path / "session")
    tissue = cv2.GaussianBlur(np.random.default_rng(1).normal(size=(240, 320, 3)), (0, 0), 5)
    gone = np.clip(np.array([60, 65, 150]) + 60 * tissue, 0, 255).astype(np.uint8)
    other = cv2.line(gone.copy(), (40, 0), (200, 239), (96, 98, 95), 34)  # the shaft of another instrument
    for frame, image in (("0005", gone), ("0009", other)):
        cv2.imwrite(str(tmp_path / "session" / "images" / f"{frame}.png"), image)
    settings = tmp_path / "settings.toml"
    settings.write_text(f"{QUICK}[trust]\ntip_mm = 3.0\n")  # small images tell little about the depth
    words = ("--evidence", "images", "--config", settings, "--workers", 1, *PLAIN)
    assert run("track", tmp_path / "session", "--out", tmp_path / "out", *words).code == 3
    found = tracks(tmp_path / "out")
    assert check(found, truth(session)) < 1.5
    assert found["0005"]["status"] == "lost"
    assert found["0005"]["reasons"] == ["lost: the image shows nothing of the instrument"]
    assert found["0009"]["status"] in ("doubtful", "lost")
    assert sum(row["status"] == "ok" for row in found.values()) >= 7
    used = json.loads((tmp_path / "out" / "session.json").read_text())["frames"]
    assert len(used) >= 10
    assert not {"0005", "0009"} & {*used}


def test_recording_of_images_alone_is_followed(kept: Kept, tmp_path: Path) -> None:
    session = kept.synth(*IMAGES)
    shutil.copytree(session, tmp_path / "session")
    first = tmp_path / "first.png"
    shutil.copy(session / "masks" / "0000.png", first)
    shutil.rmtree(tmp_path / "session" / "masks")
    run("track", tmp_path / "session", "--out", tmp_path / "out", "--causal", "--first-mask", first, *PLAIN)
    found = tracks(tmp_path / "out")
    assert not any(row["status"] == "ok" for row in found.values())
    assert check(found, truth(session)) < 3.0


def test_recording_without_readings_is_followed_and_never_ok(kept: Kept, one: Path) -> None:
    found = tracks(kept("track", one, "--joints", "none", "--every", 3, *PLAIN).folder)
    assert len(found) == 11
    assert not any(row["status"] == "ok" for row in found.values())


def test_two_arms_are_followed_by_both_eyes(kept: Kept) -> None:
    session = kept.synth(*PAIR)
    out = kept("track", session, *PLAIN).folder
    for arm in ("PSM1", "PSM2"):
        found = tracks(out / arm)
        assert len(found) == 12
        assert check(found, truth(session, arm)) < 1.5
    arms = json.loads((out / "arms.json").read_text())
    expected = np.linalg.inv(true_base(session, "PSM1")) @ true_base(session, "PSM2")
    assert distance(matrix(arms["arms"]["PSM2"], "reference_from_base"), expected) < (15.0, 8.0)
    assert "PSM2_base" in run("export", out, "--to", "tf", "--arm", "PSM2").out


def test_one_arm_can_be_chosen(kept: Kept, tmp_path: Path, quick: Path) -> None:
    words = ("--config", quick, "--only", "PSM2", "--lag", "0", "--every", "10", "--workers", 1, *PLAIN)
    assert run("track", kept.synth(*PAIR), "--out", tmp_path / "out", *words).code in (0, 3)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["PSM2", "run.json"]
    assert list(tracks(tmp_path / "out" / "PSM2")) == ["0000", "0010"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--first-mask", "a.png"), "--first-mask: expected one arm (--only ARM), got a session of several"),
        (("--box", "1,2,30,40"), "--box, --point: expected one arm (--only ARM)"),
        (("--joints", DEMO / "joints.csv"), "--joints FILE: expected one arm (--only ARM)"),
        (("--session", "session.json"), "--session: expected the folder that calibrate wrote, with a session.json for"),
        (("--only", "PSM3"), "session.toml: arm: expected one of PSM1, PSM2"),
    ],
)
def test_options_of_one_arm_are_refused(kept: Kept, tmp_path: Path, words: tuple[object, ...], expected: str) -> None:
    assert run("track", kept.synth(*PAIR), "--out", tmp_path / "out", *words).refusal.startswith(expected)


def test_steered_endoscope_has_a_base_in_each_place(kept: Kept) -> None:
    session = kept.synth(*STEERED)
    out = kept("track", session, *PLAIN).folder
    found, true = tracks(out), truth(session)
    assert check(found, true) < 1.5
    places = calibration_in(out)["endoscope"]["bases"]
    assert len(places) >= 2
    for place in places:
        expected = true[place["first"]].get("camera_from_base")
        if expected is not None:
            assert distance(matrix(place, "camera_from_base"), np.array(expected)) < (10.0, 6.0)


def test_tracker_in_python_follows_as_the_command_does(one: Path, calibration: Path) -> None:
    tracker = Tracker(read_camera(one / "camera.yaml"), prepare("lnd"), calibration=read_calibration(calibration))
    true, errors = truth(one), []
    for files in list(read_session(one).frames)[:25]:
        assert files.time is not None
        assert files.mask is not None
        mask = cv2.imread(str(files.mask), cv2.IMREAD_GRAYSCALE) > 127
        tracker.add_readings(files.time, dict(files.readings))
        result = tracker.step(files.time, mask)
        if result.tips is not None:
            errors.append(np.linalg.norm(result.tips - true[files.name]["tips_camera_m"], axis=1).max() * 1e3)
    assert len(errors) > 20
    assert median(errors) < 1.5


@pytest.fixture
def short(kept: Kept, one: Path) -> tuple[object, ...]:
    """The words that follow some frames of a recording, which are too few to know the base."""
    return "track", one, "--every", 5, "--config", kept.quick, *PLAIN


def test_interrupted_run_begins_anew_with_the_same_results(
    kept: Kept, short: tuple[object, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines, step, steps = tmp_path / "out" / "tracks.jsonl", Tracker.step, count()

    def interrupted(*args: Any, **options: Any) -> Any:
        if next(steps) == 4:
            signal.raise_signal(signal.SIGINT)
        return step(*args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "step", interrupted)
        assert run(*short, "--out", tmp_path / "out", "--workers", 1).code == 130
    assert 3 <= len(tracks(tmp_path / "out")) < 7
    with open(lines, "a", encoding="utf-8") as file:
        file.write('{"frame": "00')  # as if the process was killed while writing
    ran, whole = run(*short, "--out", tmp_path / "out", "--workers", 1), kept(*short)
    assert "followed from image to image, as by --causal: 7 frames are well in view" in ran.err
    found, expected = tracks(tmp_path / "out"), tracks(whole.folder)
    for row in (*found.values(), *expected.values()):
        del row["seconds"]
    assert found == expected


def test_another_run_replaces_all_that_an_earlier_one_wrote_and_nothing_else(
    kept: Kept, one: Path, short: tuple[object, ...], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(kept(*short).folder, out)
    (out / "notes.txt").write_text("mine")
    before, torn = content(out), tmp_path / "torn"
    shutil.copytree(one, torn)
    (torn / "masks" / "0030.png").write_bytes(b"torn")
    assert run("track", torn, *short[2:], "--causal", "--out", out, "--workers", 1).code == 2
    assert content(out) == before
    page = (*short[:-2], "--no-video", "--lag", 0.1, "--out", out, "--workers", 1)
    assert run(*page).code == 3
    assert json.loads((out / "run.json").read_text())["track"]["lag"] == 0.1
    now = content(out)
    assert now["tracks.jsonl"] != before["tracks.jsonl"]
    assert "report.html" in {*now} - {*before}
    assert run(*short, "--out", out, "--workers", 1).code == 3
    assert {*content(out)} == {*before}
    assert content(out)["notes.txt"] == before["notes.txt"]
    assert "no option here" in run(*short, "--overwrite", "--out", out).refusal


def test_doubtful_calibration_makes_all_frames_doubtful(
    one: Path, calibration: Path, short: tuple[object, ...], tmp_path: Path
) -> None:
    document = calibration_in(calibration.parent)
    doubt = "the camera file is contradicted"
    (tmp_path / "session.json").write_text(json.dumps(document | {"status": "doubtful", "doubts": [doubt]}))
    run(*short, "--session", tmp_path / "session.json", "--out", tmp_path / "out", "--workers", 1)
    found = tracks(tmp_path / "out")
    check(found, truth(one))
    assert not any(row["status"] == "ok" for row in found.values())
    assert {row["reasons"][0] for row in found.values()} == {f"session: {doubt}"}


BACK = [*range(2, 26, 6), *range(26, 2, -6)] * 2
"""Frames of a motion there and back, with a period of 8 images, twice."""


@pytest.mark.parametrize(
    ("masks", "rows", "expected"),
    [
        (range(9), range(5, 14), "end of the range"),  # late by 2 + 5 frames, and only so much is read
        ([BACK[k - 2] + 2 for k in range(16)], BACK, "about as well"),
    ],
)
def test_lag_that_the_frames_do_not_determine_is_not_taken_out(
    one: Path, tmp_path: Path, quick: Path, masks: Sequence[int], rows: Sequence[int], expected: str
) -> None:
    """The images of the recording are late by two frames; here, each has the mask and the readings of these frames."""
    session = tmp_path / "session"
    (session / "masks").mkdir(parents=True)
    shutil.copy(one / "camera.yaml", session)
    head, *lines = (one / "joints.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines]
    for k, number in enumerate(masks):
        shutil.copy(one / "masks" / f"{number:04d}.png", session / "masks" / f"{k:04d}.png")
    table = [",".join([*cells[k][:2], *cells[row][2:]]) for k, row in enumerate(rows)]
    (session / "joints.csv").write_text("\n".join([head, *table]) + "\n")
    run("calibrate", session, "--out", tmp_path / "out", "--config", quick, "--workers", 1)
    document = calibration_in(tmp_path / "out")
    assert document["lag"] is None
    assert any(expected in text for text in document["undetermined"])
