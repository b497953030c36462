"""A batch: results of all frames despite failures, and resuming only with the same inputs and settings."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK_CONFIG, comparable, make_session
from helpers.done_once import found_by_model
from helpers.files import read_mask

from dvrk_cmaes import Body, EstimateConfig, InputError, Result, prepare, read_session
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.runs.batch import BatchSummary, finish, run_batch
from dvrk_cmaes.runs.frame import ArmInSession, FrameOutcome, write_outcome
from dvrk_cmaes.runs.pool import Workers

pytestmark = pytest.mark.usefixtures("estimates_shared")

Batch = Callable[..., BatchSummary]


@pytest.fixture
def batch(bundled_body: Body, tmp_path: Path) -> Iterator[Batch]:
    """Run a batch in this process; ``session`` and ``out`` are folders."""
    with ThreadPoolExecutor(1) as thread:

        def go(session: Path, out: Path | str = "out", **options: object) -> BatchSummary:
            method = FrameMethod(options.pop("kinematics", "classic"), QUICK_CONFIG)  # type: ignore[arg-type]
            arm = ArmInSession(read_session(session), bundled_body, method)
            return run_batch(arm, tmp_path / out, workers=Workers(executor=thread), **options)  # type: ignore[arg-type]

        yield go


@pytest.fixture
def two(tmp_path: Path) -> Path:
    return make_session(tmp_path / "two", ["0001", "0002"])


def refusal(batch: Batch, *arguments: object, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        batch(*arguments, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_resume_with_other_instrument_is_refused(batch: Batch, two: Path, tmp_path: Path, bundled_body: Body) -> None:
    batch(two)
    limits = bundled_body.instrument.limits + 0.1
    other = prepare(replace(bundled_body.instrument, limits=limits))
    arm = ArmInSession(read_session(two), other, FrameMethod("classic", QUICK_CONFIG))
    with pytest.raises(InputError, match=r"its results were made otherwise \(instrument.digest: \w{16} -> \w{16}\)"):
        run_batch(arm, tmp_path / "out", workers=Workers())


def test_resume_with_changed_files_is_refused(batch: Batch, two: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch(two)
    shutil.copy(two / "masks" / "0001.png", two / "masks" / "0002.png")
    rows = (two / "joints.csv").read_text(encoding="utf-8").replace("0.017913", "0.018")
    (two / "joints.csv").write_text(rows, encoding="utf-8")
    assert refusal(batch, two) == (
        f"{out}: frames have changed since their results were made: 0002 (mask, readings): "
        "choose another --out, or begin anew with --overwrite"
    )
    (out / "frames" / "0002.json").unlink()
    assert batch(two).ran == 1
    (two / "masks" / "0001.png").unlink()
    assert refusal(batch, two) == (
        f"{out}: it has results of frames that are not in the session: 0001: "
        "choose another --out, or begin anew with --overwrite"
    )


def test_failed_frames_are_repeated(batch: Batch, two: Path, tmp_path: Path) -> None:
    mask = two / "masks" / "0002.png"
    sound = mask.read_bytes()
    batch(two, "sound")
    mask.write_bytes(b"nonsense")
    assert batch(two).document["counts"]["failed"] == 1
    done = batch(two)
    assert (done.ran, done.document["counts"]["failed"]) == (1, 1)
    mask.write_bytes(sound)
    done = batch(two)
    assert (done.ran, done.document["counts"]["failed"]) == (1, 0)
    assert comparable(tmp_path / "out") == comparable(tmp_path / "sound")


@pytest.mark.parametrize("kept", [True, False], ids=["before", "after some"])
def test_batch_that_ends_while_images_are_looked_at_again_is_resumed_with_these(
    batch: Batch, two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: bool
) -> None:
    found_by_model(monkeypatch, read_mask(two / "masks" / "0002.png"), 0.9)
    (two / "images").mkdir()
    shutil.move(two / "masks" / "0002.png", two / "images")
    looked = list[set[str]]()

    def elsewhere(arm: ArmInSession, results: dict[str, Result], _notice: object) -> list[FrameFiles]:
        looked.append({*results})
        if kept and len(looked) == 1:
            raise MemoryError
        return [replace(arm.session.frames[1], start=results["0002"])]

    def killed(out: Path, outcome: FrameOutcome) -> None:
        if looked == [{"0001", "0002"}]:
            raise MemoryError
        write_outcome(out, outcome)

    monkeypatch.setattr("dvrk_cmaes.runs.batch.expected_elsewhere", elsewhere)
    monkeypatch.setattr("dvrk_cmaes.runs.batch.write_outcome", killed)
    with pytest.raises(MemoryError):
        batch(two)
    looked.append(set())
    assert [batch(two).ran for _ in range(2)] == [0 if kept else 1, 0]
    assert looked == [{"0001", "0002"}, set(), {"0001", "0002"}]
    batch(two, "whole")
    assert comparable(tmp_path / "out") == comparable(tmp_path / "whole")


def test_settings_may_change_while_all_frames_have_failed(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two, "sound", kinematics="si")
    masks = {path: path.read_bytes() for path in (two / "masks").iterdir()}
    for path in masks:
        path.write_bytes(b"nonsense")
    assert batch(two).document["counts"]["failed"] == 2
    for path, data in masks.items():
        path.write_bytes(data)
    done = batch(two, kinematics="si")
    assert (done.ran, done.document["counts"]["failed"]) == (2, 0)
    assert comparable(tmp_path / "out") == comparable(tmp_path / "sound")
    assert "arm: si -> classic" in refusal(batch, two)


@pytest.mark.parametrize("name", ["frames/0001.json", "overlays/0001.jpg", "summary.json", "report.html"])
def test_folder_in_the_place_of_a_file_is_refused_first(batch: Batch, two: Path, tmp_path: Path, name: str) -> None:
    batch(two, pattern="0002")
    there = tmp_path / "out" / name
    there.unlink(missing_ok=True)
    (there / "inner").mkdir(parents=True)
    before = {path: path.lstat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    for resume in (True, False):
        assert refusal(batch, two, resume=resume) == f"{there}: expected a file, or none yet, but a folder is there"
    assert {path: path.lstat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == before


def test_file_in_the_place_of_a_folder_is_refused_first(batch: Batch, two: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "overlays").write_text("mine")
    expected = f"{tmp_path / 'out'}: expected a folder to write to, but {tmp_path / 'out' / 'overlays'} is a file"
    assert refusal(batch, two) == expected
    (tmp_path / "out" / "overlays").rename(tmp_path / "overlays")
    batch(two, pattern="0001")
    shutil.rmtree(tmp_path / "out" / "overlays")
    (tmp_path / "overlays").rename(tmp_path / "out" / "overlays")
    assert refusal(batch, two) == expected
    assert (tmp_path / "out" / "overlays").read_text() == "mine"


def test_damaged_summary_is_replaced(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two)
    whole = comparable(tmp_path / "out")
    (tmp_path / "out" / "summary.json").write_bytes(b'{"cut')
    assert batch(two).ran == 0
    assert comparable(tmp_path / "out") == whole


def test_pattern_selects_frames(batch: Batch, two: Path, tmp_path: Path) -> None:
    assert list(batch(two, pattern="*2").document["frames"]) == ["0002"]
    assert list(batch(two).document["frames"]) == ["0001", "0002"]
    batch(two, "at once")
    assert comparable(tmp_path / "out") == comparable(tmp_path / "at once")
    assert refusal(batch, two, pattern="3*") == (
        "--frames: expected a pattern of some of the 2 frames (0001, 0002), got '3*'"
    )


def test_session_may_be_moved(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two)
    moved = tmp_path / "elsewhere" / "moved"
    moved.parent.mkdir()
    os.rename(two, moved)
    assert batch(moved).ran == 0
    batch(moved, "other")
    here, there = comparable(tmp_path / "out"), comparable(tmp_path / "other")
    assert {name for name in here if here[name] != there[name]} <= {"run.json", "summary.json"}


def test_tables_can_be_rewritten(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two)
    out = tmp_path / "out"
    whole = comparable(out)
    for name in ("poses.csv", "summary.json", "report.html"):
        (out / name).unlink()
    finish(out)
    assert comparable(out) == whole
    with pytest.raises(InputError, match="expected results of a batch, got none"):
        finish(two)


def test_wrist_readings_that_never_move_are_one_warning_of_all_frames(batch: Batch, tmp_path: Path) -> None:
    folder = make_session(tmp_path / "session", ["0001", "0002", "0003", "0004", "0005"])
    with open(folder / "joints.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with open(folder / "joints.csv", "w", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(row | {"wrist_pitch": "0", "wrist_yaw": "0"} for row in rows)
    done = batch(folder)
    assert done.document["commanded"] == ["wrist_pitch", "wrist_yaw"]
    for result in done.results.values():
        (text,) = [text for text in result.warnings if "never move" in text]
        assert text.startswith("wrist readings never move: wrist_pitch and wrist_yaw constant while the arm moves")
        assert result.config["readings"]["wrist_pitch_deg"] == 2 * EstimateConfig().readings.wrist_pitch_deg
    assert "wrist readings never move" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
