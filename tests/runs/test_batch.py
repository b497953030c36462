"""A batch: results of all frames despite failures, and resuming only with the same inputs and settings."""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG, comparable, make_session

from dvrk_cmaes import Body, DvrkCmaesError, EstimateConfig, InputError, __version__, read_results, read_session
from dvrk_cmaes.io.output import output
from dvrk_cmaes.runs.batch import BatchSummary, Workers, finish, run_batch

Batch = Callable[..., BatchSummary]


@pytest.fixture
def batch(bundled_body: Body, tmp_path: Path) -> Iterator[Batch]:
    """Run a batch in this process; ``session`` and ``out`` are folders."""
    with ThreadPoolExecutor(1) as thread:

        def go(session: Path, out: Path | str = "out", **options: object) -> BatchSummary:
            given = {"config": QUICK_CONFIG, "workers": Workers(executor=thread), **options}
            return run_batch(read_session(session), tmp_path / out, bundled_body.instrument, **given)  # type: ignore[arg-type]

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


def written_at(out: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in sorted((out / "frames").iterdir())}


@pytest.mark.usefixtures("estimates_shared")
def test_batch_writes_results_overlays_tables_and_page(batch: Batch, tmp_path: Path) -> None:
    names = ["0001", "Bild 2 für uns", "名前, 3"]
    done = batch(make_session(tmp_path / "session", names))
    out = tmp_path / "out"
    assert sorted(comparable(out)) == sorted(
        ["poses.csv", "report.html", "run.json", "summary.json"]
        + [f"frames/{name}.json" for name in names]
        + [f"overlays/{name}.jpg" for name in names]
    )
    with (out / "poses.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == names
    assert {"camera_from_root_x_mm", "camera_from_root_qw", "wrist_pitch_deg", "jaw_read_deg", "iou"} <= set(rows[0])
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary == done.document
    assert (summary["counts"]["frames"], summary["counts"]["missing"], done.ran) == (3, 0, 3)
    assert list(summary["frames"]) == names
    assert set(summary["timing"]) == {"frame_seconds", "run"}
    assert not done.interrupted


@pytest.mark.usefixtures("estimates_shared")
def test_unusable_frames_fail_with_reason(batch: Batch, tmp_path: Path) -> None:
    session = make_session(tmp_path / "session", ["bad row", "black", "good", "large ignore", "torn", "unmasked"])
    masks = session / "masks"
    (masks / "black.png").write_bytes(cv2.imencode(".png", np.zeros((120, 160), np.uint8))[1].tobytes())
    (masks / "torn.png").write_bytes((masks / "good.png").read_bytes()[:50])
    (session / "images").mkdir()
    (masks / "unmasked.png").unlink()
    (session / "images" / "unmasked.png").write_bytes(
        cv2.imencode(".png", np.full((120, 160), 128, np.uint8))[1].tobytes()
    )
    (session / "ignore").mkdir()
    (session / "ignore" / "large ignore.png").write_bytes(
        cv2.imencode(".png", np.zeros((240, 320), np.uint8))[1].tobytes()
    )
    rows = (session / "joints.csv").read_text(encoding="utf-8")
    (session / "joints.csv").write_text(rows.replace("-0.173334", "many", 1), encoding="utf-8")
    done = batch(session)
    assert done.counts == {"frames": 6, "ok": 0, "doubtful": 1, "failed": 5, "missing": 0}  # so small, tips are unsure
    results = read_results(tmp_path / "out").frames
    assert {name: result.reasons[0] for name, result in results.items() if result.status == "failed"} == {
        "bad row": "joints.csv: frame bad row: yaw: expected a finite number in rad, got 'many'",
        "black": "masks/black.png: mask is empty: expected pixels above 127 on the instrument, got none "
        "(the largest value is 0)",
        "large ignore": "ignore/large ignore.png: expected the mask's size 160 x 120, got 320 x 240 (width x height)",
        "torn": "masks/torn.png: expected a mask (PNG or JPEG), got one that is cut off or damaged",
        "unmasked": "images/unmasked.png: no instrument found in the image; a mask, a box or a point on the instrument "
        "would help",
    }
    failed = results["torn"]
    assert (failed.camera_from_root, failed.instrument, set(failed.readings)) == (
        None,
        "lnd",
        set(results["good"].readings),
    )
    pictures = {path.stem for path in (tmp_path / "out" / "overlays").iterdir()}
    assert pictures == set(results) - {"torn"}  # every frame has a picture, unless none can be read
    settings = {json.dumps(result.config, sort_keys=True) for result in results.values()}
    assert len(settings) == 1


def test_resume_estimates_missing_frames_only(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two)
    out = tmp_path / "out"
    whole, before = comparable(out), written_at(out)
    assert batch(two).ran == 0
    (out / "frames" / "0001.json").unlink()
    (out / "frames" / f".{'a' * 32}.tmp").write_text("half")
    assert batch(two).ran == 1
    (out / "frames" / "0001.json").write_text("{")  # as after a power cut
    assert batch(two).ran == 1
    (out / "overlays" / "0001.jpg").unlink()
    assert batch(two).ran == 1
    assert comparable(out) == whole
    assert written_at(out)["0002.json"] == before["0002.json"]


def test_resume_with_other_settings_is_refused(
    batch: Batch, two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    batch(two)
    way_out = "choose another --out, or begin anew with --overwrite"
    otherwise = f"{out}: its results were made otherwise"
    assert refusal(batch, two, config=replace(QUICK_CONFIG, seed=3)) == f"{otherwise} (config.seed: 0 -> 3): {way_out}"
    assert refusal(batch, two, arm="si") == f"{otherwise} (arm: classic -> si): {way_out}"
    camera = (two / "camera.yaml").read_text(encoding="utf-8")
    (two / "camera.yaml").write_text(camera.replace("image_width: 640", "image_width: 644"), encoding="utf-8")
    assert refusal(batch, two) == f"{otherwise} (camera.width: 640 -> 644): {way_out}"
    (two / "camera.yaml").write_text(camera, encoding="utf-8")
    monkeypatch.setattr("dvrk_cmaes.runs.manifest.__version__", "9.9")
    assert refusal(batch, two) == f"{otherwise} (version: {__version__} -> 9.9): {way_out}"


@pytest.mark.usefixtures("estimates_shared")
def test_resume_with_other_instrument_is_refused(batch: Batch, two: Path, tmp_path: Path, bundled_body: Body) -> None:
    batch(two)
    limits = bundled_body.instrument.limits + 0.1
    other = replace(bundled_body.instrument, limits=limits)
    with pytest.raises(InputError, match=r"its results were made otherwise \(instrument.digest: \w{16} -> \w{16}\)"):
        run_batch(read_session(two), tmp_path / "out", other, config=QUICK_CONFIG)


@pytest.mark.usefixtures("estimates_shared")
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


@pytest.mark.usefixtures("estimates_shared")
def test_failed_frames_are_repeated_on_request_or_when_their_files_have_changed(
    batch: Batch, two: Path, tmp_path: Path
) -> None:
    mask = two / "masks" / "0002.png"
    sound = mask.read_bytes()
    batch(two, "sound")
    mask.write_bytes(b"nonsense")
    assert batch(two).counts["failed"] == 1
    assert batch(two).ran == 0
    done = batch(two, retry_failed=True)
    assert (done.ran, done.counts["failed"]) == (1, 1)
    mask.write_bytes(sound)
    done = batch(two)
    assert (done.ran, done.counts["failed"]) == (1, 0)
    assert comparable(tmp_path / "out") == comparable(tmp_path / "sound")


@pytest.mark.usefixtures("estimates_shared")
def test_settings_may_change_while_all_frames_have_failed(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two, "sound", arm="si")
    masks = {path: path.read_bytes() for path in (two / "masks").iterdir()}
    for path in masks:
        path.write_bytes(b"nonsense")
    assert batch(two).counts["failed"] == 2
    for path, data in masks.items():
        path.write_bytes(data)
    done = batch(two, arm="si")
    assert (done.ran, done.counts["failed"]) == (2, 0)
    assert comparable(tmp_path / "out") == comparable(tmp_path / "sound")
    assert "arm: si -> classic" in refusal(batch, two)


@pytest.mark.usefixtures("estimates_shared")
def test_overwrite_keeps_unrelated_files(batch: Batch, two: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch(two)
    (out / "notes.txt").write_text("mine")
    (two / "masks" / "0001.png").unlink()
    done = batch(two, resume=False, config=replace(QUICK_CONFIG, seed=5))
    assert (done.ran, list(done.document["frames"])) == (1, ["0002"])
    assert (out / "notes.txt").read_text() == "mine"
    assert sorted(path.name for path in (out / "overlays").iterdir()) == ["0002.jpg"]


@pytest.mark.usefixtures("estimates_shared")
def test_folder_with_other_results_is_refused(batch: Batch, two: Path, tmp_path: Path) -> None:
    other = tmp_path / "out" / "frames" / "x.json"
    other.parent.mkdir(parents=True)
    other.write_text("{}")
    for resume in (True, False):
        assert refusal(batch, two, resume=resume) == (
            f"{tmp_path / 'out'}: expected a new or empty folder, or one of an earlier batch, got one with "
            "frames; nothing was changed"
        )
    assert other.read_text() == "{}"


@pytest.mark.usefixtures("estimates_shared")
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


@pytest.mark.usefixtures("estimates_shared")
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


@pytest.mark.usefixtures("estimates_shared")
def test_damaged_summary_is_replaced(batch: Batch, two: Path, tmp_path: Path) -> None:
    batch(two)
    whole = comparable(tmp_path / "out")
    (tmp_path / "out" / "summary.json").write_bytes(b'{"cut')
    assert batch(two).ran == 0
    assert comparable(tmp_path / "out") == whole


@pytest.mark.usefixtures("estimates_shared")
def test_pattern_selects_frames(batch: Batch, two: Path, tmp_path: Path) -> None:
    assert list(batch(two, pattern="*2").document["frames"]) == ["0002"]
    assert list(batch(two).document["frames"]) == ["0001", "0002"]
    batch(two, "at once")
    assert comparable(tmp_path / "out") == comparable(tmp_path / "at once")
    assert refusal(batch, two, pattern="3*") == (
        "--frames: expected a pattern of some of the 2 frames (0001, 0002), got '3*'"
    )


@pytest.mark.usefixtures("estimates_shared")
def test_unwritable_names_and_folders_are_refused_first(batch: Batch, tmp_path: Path, two: Path) -> None:
    (tmp_path / "file").write_text("")
    assert refusal(batch, two, "file") == (
        f"{tmp_path / 'file'}: expected a folder to write to, but {tmp_path / 'file'} is a file"
    )
    shutil.copy(two / "masks" / "0001.png", two / "masks" / f"{'x' * 251}.png")
    assert refusal(batch, two) == ("frame: expected a name of at most 255 bytes with .json, got '" + "x" * 56 + "...")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("estimates_shared")
def test_second_batch_in_same_folder_is_refused(batch: Batch, two: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with output(out, "batch"), pytest.raises(DvrkCmaesError) as caught, ThreadPoolExecutor(1) as other:
        other.submit(batch, two).result()
    assert str(caught.value) == f"{out}: another command is writing there; wait for it, or choose another --out"
    assert batch(two).ran == 2


@pytest.mark.usefixtures("estimates_shared")
def test_session_may_be_moved(batch: Batch, two: Path, tmp_path: Path) -> None:
    (two / "masks" / "0002.png").write_bytes(b"nonsense")
    batch(two)
    moved = tmp_path / "elsewhere" / "moved"
    moved.parent.mkdir()
    os.rename(two, moved)
    assert batch(moved).ran == 0
    batch(moved, "other")
    here, there = comparable(tmp_path / "out"), comparable(tmp_path / "other")
    assert {name for name in here if here[name] != there[name]} <= {"run.json", "summary.json"}


@pytest.mark.usefixtures("estimates_shared")
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


@pytest.mark.usefixtures("estimates_shared")
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
    assert "wrist readings never move" in (done.folder / "report.html").read_text(encoding="utf-8")
