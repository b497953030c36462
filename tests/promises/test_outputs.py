"""What commands write and print: folders, links, users' files, two commands, kills, streams and exit codes."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from promises.program import DEMO, PROGRAM, QUICK, Kept, Ran, content, run
from promises.truth import results, truth

FRAME = (
    *("--mask", DEMO / "masks" / "0001.png", "--camera", DEMO / "camera.yaml"),
    *("--joints", DEMO / "joints.csv", "--image", DEMO / "images" / "0001.jpg"),
)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """The bundled session in a folder of its own."""
    shutil.copytree(DEMO, tmp_path / "session")
    return tmp_path / "session"


@pytest.fixture
def batched(kept: Kept, tmp_path: Path) -> Path:
    """Results of the bundled session, in a folder that may be changed."""
    return Path(shutil.copytree(kept("batch", DEMO, "--config", kept.quick).folder, tmp_path / "batched"))


def again(kept: Kept, out: Path, *more: object) -> Ran:
    """Run the command of ``batched`` again."""
    return run("batch", DEMO, "--out", out, "--config", kept.quick, "--workers", 1, *more)


def started(*words: object, folder: Path) -> subprocess.Popen[str]:
    """Start a command in a process of its own."""
    pipe = subprocess.PIPE
    return subprocess.Popen([PROGRAM, *map(str, words)], cwd=folder, stdout=pipe, stderr=pipe, text=True)


def without_times(folder: Path) -> dict[str, object]:
    """Give the results of a folder by frame, without how long they took."""
    return {frame: result | {"seconds": 0} for frame, result in results(folder).items()}


def wait_until(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    """Wait for a condition."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


# streams and exit codes


def test_estimate_prints_pose_and_files_and_exits_by_status(tmp_path: Path) -> None:
    ran = run("estimate", *FRAME, "--out", "out", folder=tmp_path)
    assert (ran.code, ran.err) == (0, "")
    assert re.match(r"0001: tips within 1\.\d mm \(90 %.*\), ok\n", ran.out)
    assert ran.out.endswith("written: out/frames/0001.json\nwritten: out/overlays/0001.jpg\n")
    assert set(content(tmp_path / "out")) >= {"frames/0001.json", "overlays/0001.jpg"}
    doubtful = run("estimate", *FRAME[:4], "--joints", "none", folder=tmp_path)
    assert doubtful.code == 3
    assert "doubtful" in doubtful.out


def test_json_on_stdout_is_the_document_alone(kept: Kept, tmp_path: Path, batched: Path) -> None:
    one, two = (run("estimate", *FRAME, "--json", "--seed", 3, folder=tmp_path) for _ in range(2))
    assert (one.code, one.err) == (0, "")
    first, second = one.document, two.document
    assert first.pop("seconds") > 0
    del second["seconds"]
    assert first == second  # the same input and seed
    assert (first["schema"], first["status"], first["seed"]) == (1, "ok", 3)
    summary = again(kept, batched, "--json").document
    assert summary["counts"]["ok"] + summary["counts"]["doubtful"] == 5
    assert summary == json.loads((batched / "summary.json").read_text())


def test_closed_or_full_stdout_is_no_traceback(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        ran = subprocess.run([PROGRAM, "help", "formats"], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ran.returncode == 1
    assert ran.stderr.count("\n") == 1
    head = subprocess.run(f"{PROGRAM} help formats | head -1", shell=True, capture_output=True, text=True, check=False)
    assert head.stdout.count("\n") == 1
    assert "Traceback" not in head.stderr


# what a folder of results has


def test_batch_writes_results_tables_and_a_page(batched: Path) -> None:
    names = {
        f"{name}/{frame}.{kind}" for frame in truth(DEMO) for name, kind in (("frames", "json"), ("overlays", "jpg"))
    }
    assert names | {"poses.csv", "summary.json", "report.html"} <= set(content(batched))
    rows = csv.DictReader((batched / "poses.csv").read_text().splitlines())
    for row, result in zip(rows, results(batched).values(), strict=True):
        assert (row["frame"], row["status"]) == (result["frame"], result["status"])
    page = (batched / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page


def test_file_that_cannot_be_read_fails_its_frame_alone(session: Path, tmp_path: Path) -> None:
    (session / "masks" / "0002.png").write_bytes(b"\x89PNG\r\n\x1a\n torn")
    ran = run("batch", session, "--out", tmp_path / "out", "--frames", "000[12]", "--workers", 1)
    found = results(tmp_path / "out")
    assert ran.code == 3
    assert found["0002"]["status"] == "failed"
    assert "0002.png" in found["0002"]["reasons"][0]
    assert found["0001"]["status"] == "ok"


# going on


def test_batch_goes_on_with_the_same_answers(kept: Kept, batched: Path) -> None:
    """A finished batch is left as it is; a frame that is missing is estimated again."""
    before, frames = results(batched), content(batched / "frames")
    assert again(kept, batched).code in (0, 3)
    assert content(batched / "frames") == frames
    (batched / "frames" / "0003.json").unlink()
    assert again(kept, batched).code in (0, 3)
    assert without_times(batched) == {frame: row | {"seconds": 0} for frame, row in before.items()}


def test_results_of_other_settings_are_never_mixed(batched: Path, tmp_path: Path) -> None:
    before, other = content(batched), tmp_path / "seed.toml"
    other.write_text(f"seed = 7\n{QUICK}")
    refusal = run("batch", DEMO, "--out", batched, "--config", other).refusal
    assert "seed" in refusal
    assert "--overwrite" in refusal
    assert content(batched) == before
    options = ("--config", other, "--frames", "0001", "--overwrite", "--workers", 1)
    assert run("batch", DEMO, "--out", batched, *options).code in (0, 3)
    assert list(results(batched)) == ["0001"]


def test_interrupted_batch_goes_on_to_the_same_results_and_is_alone_until_then(
    kept: Kept, batched: Path, tmp_path: Path
) -> None:
    out = tmp_path / "interrupted"
    process = started("batch", DEMO, "--out", out, "--config", kept.quick, "--workers", 1, folder=tmp_path)
    wait_until(lambda: len([*out.glob("frames/*.json")]) >= 2)
    process.send_signal(signal.SIGSTOP)
    second = run("batch", DEMO, "--out", out)
    for number in (signal.SIGINT, signal.SIGCONT):
        process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (second.code in (1, 2), second.out) == (True, "")
    assert f"{out}: another command is writing there" in second.err
    assert process.returncode == 130
    assert "Traceback" not in err
    assert again(kept, out).code in (0, 3)
    assert without_times(out) == without_times(batched)
    assert not [name for name in content(out) if name.endswith((".tmp", ".part"))]


# users' files and links


def test_users_file_is_neither_replaced_nor_removed(kept: Kept, batched: Path) -> None:
    (batched / "notes.txt").write_text("mine")
    (batched / "frames" / "notes.txt").write_text("mine")
    assert again(kept, batched, "--overwrite", "--frames", "0001").code in (0, 3)
    assert (batched / "notes.txt").read_text() == "mine"
    assert (batched / "frames" / "notes.txt").read_text() == "mine"
    (batched / "overlays" / "0001.jpg").write_bytes(b"edited")
    assert "0001.jpg" in again(kept, batched, "--overwrite", "--frames", "0001").refusal
    assert (batched / "overlays" / "0001.jpg").read_bytes() == b"edited"


@pytest.mark.parametrize("command", ["batch", "calibrate", "track", "segment"])
def test_folder_that_no_command_wrote_is_refused(session: Path, tmp_path: Path, command: str) -> None:
    shutil.copytree(DEMO, tmp_path / "another")
    for name, file in (("pictures", "0001.png"), ("notes", "run.json")):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_text("mine")
    before = content(tmp_path)
    for name in ("another", "pictures", "notes"):
        for more in ((), ("--overwrite",)) if command == "batch" else ((),):
            refusal = run(command, session, "--out", tmp_path / name, *more).refusal
            assert refusal.startswith(f"{tmp_path / name}")
    assert content(tmp_path) == before


@pytest.mark.parametrize("command", ["batch", "calibrate", "track"])
def test_session_is_no_output_folder_of_its_own(session: Path, command: str, tmp_path: Path) -> None:
    before = content(session)
    (tmp_path / "link").symlink_to(session)
    for out in (session, tmp_path / "link", session / "masks"):
        assert run(command, session, "--out", out).code == 2
    assert content(session) == before


@pytest.mark.parametrize("kind", ["file", "folder", "dangling"])
def test_no_link_in_the_output_is_followed(kept: Kept, batched: Path, tmp_path: Path, kind: str) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "precious.json").write_text("mine")
    if kind == "folder":
        shutil.rmtree(batched / "frames")
        (batched / "frames").symlink_to(outside)
    else:
        (batched / "frames" / "0001.json").unlink()
        target = outside / ("precious.json" if kind == "file" else "new.json")
        (batched / "frames" / "0001.json").symlink_to(target)
    before = content(outside)
    for more in ((), ("--overwrite",)):
        assert "link" in again(kept, batched, *more).refusal
    assert content(outside) == before


def test_output_folder_may_itself_be_a_link(kept: Kept, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    assert again(kept, tmp_path / "out", "--frames", "0001").code in (0, 3)
    assert (tmp_path / "disk" / "frames" / "0001.json").is_file()


def test_name_of_a_frame_cannot_lead_out_of_the_folder(tmp_path: Path) -> None:
    for name in ("../evil", "a/b", ".hidden"):
        words = (*FRAME[:4], "--joints", "wrist_yaw=0.55,jaw=0.83", "--frame", name, "--out", tmp_path / "x" / "out")
        assert name in run("estimate", *words).refusal
        assert not (tmp_path / "x").exists()


def test_full_disk_leaves_no_partial_file(tmp_path: Path) -> None:
    limited = f"ulimit -f 4; exec {PROGRAM} estimate {' '.join(map(str, FRAME))} --out out"
    ran = subprocess.run(["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 1, ran.stderr
    assert ran.stderr.startswith("dvrk-cmaes: ")
    assert "Traceback" not in ran.stderr
    for path in (tmp_path / "out").rglob("*.json"):
        if not path.name.startswith("."):
            json.loads(path.read_text())


def test_unwritable_place_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    ran = run("estimate", *FRAME, "--out", tmp_path / "file" / "out")
    assert ran.code in (1, 2)
    assert str(tmp_path / "file") in ran.err
    assert ran.err.count("\n") == 1
