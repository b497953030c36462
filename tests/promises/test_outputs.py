"""What commands write and print: folders, links, users' files, two commands, kills, streams and exit codes."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from promises.program import DEMO, OUT, PROGRAM, QUICK, Kept, Ran, content, results, run, truth

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
    settings = kept.base / "quick.toml"
    settings.write_text(QUICK)
    shutil.copytree(kept("batch", DEMO, "--out", OUT, "--config", settings).folder, tmp_path / "batched")
    return tmp_path / "batched"


def again(kept: Kept, out: Path, *more: object) -> Ran:
    """Run the command of ``batched`` again."""
    return run("batch", DEMO, "--out", out, "--config", kept.base / "quick.toml", *more)


def of_another_seed(folder: Path) -> Path:
    """Write the settings of ``batched`` with another seed."""
    (folder / "seed.toml").write_text(f"seed = 7\n{QUICK}")
    return folder / "seed.toml"


def started(*words: object, folder: Path) -> subprocess.Popen[str]:
    """Start a command in a process of its own."""
    pipe = subprocess.PIPE
    return subprocess.Popen([PROGRAM, *map(str, words)], cwd=folder, stdout=pipe, stderr=pipe, text=True)


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


@pytest.mark.parametrize("words", [("--help",), ("--version",), ("estimate", "--help"), ("help",), ("help", "formats")])
def test_help_is_printed_on_stdout(words: tuple[str, ...]) -> None:
    ran = run(*words)
    assert (ran.code, ran.err) == (0, "")
    assert len(ran.out) > 5


def test_every_command_of_the_stable_list_has_help() -> None:
    shown = subprocess.run([PROGRAM, "--help"], capture_output=True, text=True, check=True).stdout
    for command in ("estimate", "segment", "demo", "batch", "calibrate", "track", "live", "export", "golden"):
        assert f" {command} " in shown
    for command in ("compare", "consistency", "pnp", "synth", "inspect", "import", "help"):
        assert f" {command} " in shown


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
    names = set(content(batched))
    for frame in truth(DEMO):
        assert {f"frames/{frame}.json", f"overlays/{frame}.jpg"} <= names
    assert {"poses.csv", "summary.json", "report.html"} <= names
    header, *rows = (batched / "poses.csv").read_text().splitlines()
    assert len(rows) == 5
    for row, result in zip(rows, results(batched).values(), strict=True):
        named = dict(zip(header.split(","), row.split(","), strict=True))
        assert named["frame"] == result["frame"]
        assert named["status"] == result["status"]
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


def test_finished_batch_is_left_as_it_is(kept: Kept, batched: Path) -> None:
    frames = {name: data for name, data in content(batched).items() if name.startswith("frames/")}
    assert again(kept, batched).code in (0, 3)
    assert {name: data for name, data in content(batched).items() if name.startswith("frames/")} == frames


def test_missing_frame_is_estimated_again_with_the_same_answer(kept: Kept, batched: Path) -> None:
    before = results(batched)["0003"]
    (batched / "frames" / "0003.json").unlink()
    assert again(kept, batched).code in (0, 3)
    after = results(batched)["0003"]
    for result in (before, after):
        del result["seconds"]
    assert after == before


def test_results_of_other_settings_are_never_mixed(batched: Path, tmp_path: Path) -> None:
    before, other = content(batched), of_another_seed(tmp_path)
    refusal = run("batch", DEMO, "--out", batched, "--config", other).refusal
    assert "seed" in refusal
    assert "--overwrite" in refusal
    assert content(batched) == before
    options = ("--config", other, "--frames", "0001", "--overwrite", "--workers", 1)
    assert run("batch", DEMO, "--out", batched, *options).code in (0, 3)
    assert list(results(batched)) == ["0001"]


def test_interrupted_batch_goes_on_to_the_same_results(kept: Kept, batched: Path, tmp_path: Path) -> None:
    out = tmp_path / "interrupted"
    words = ("batch", DEMO, "--out", out, "--config", kept.base / "quick.toml", "--workers", 1)
    process = started(*words, folder=tmp_path)
    wait_until(lambda: len(list((out / "frames").glob("*.json"))) >= 2 if (out / "frames").exists() else False)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert again(kept, out).code in (0, 3)
    expected, found = results(batched), results(out)
    for result in (*expected.values(), *found.values()):
        del result["seconds"]
    assert found == expected
    assert not [name for name in content(out) if name.endswith((".tmp", ".part"))]


def test_second_command_in_a_folder_is_refused_while_the_first_runs(tmp_path: Path, quick: Path) -> None:
    out = tmp_path / "out"
    first = started("batch", DEMO, "--out", out, "--config", quick, "--workers", 1, folder=tmp_path)
    try:
        wait_until(lambda: out.is_dir() and any(out.iterdir()))
        second = run("batch", DEMO, "--out", out)
        assert (second.code in (1, 2), second.out) == (True, "")
        assert f"{out}: another command is writing there" in second.err
    finally:
        _, err = first.communicate(timeout=300)
    assert first.returncode in (0, 3), err
    assert len(results(out)) == 5


# users' files and links


def test_users_file_is_neither_replaced_nor_removed(kept: Kept, batched: Path) -> None:
    (batched / "notes.txt").write_text("mine")
    (batched / "frames" / "notes.txt").write_text("mine")
    assert again(kept, batched, "--overwrite", "--frames", "0001", "--workers", 1).code in (0, 3)
    assert (batched / "notes.txt").read_text() == "mine"
    assert (batched / "frames" / "notes.txt").read_text() == "mine"
    (batched / "overlays" / "0001.jpg").write_bytes(b"edited")
    ran = again(kept, batched, "--overwrite", "--frames", "0001", "--workers", 1)
    assert "0001.jpg" in ran.refusal
    assert (batched / "overlays" / "0001.jpg").read_bytes() == b"edited"


@pytest.mark.parametrize("command", ["batch", "calibrate", "track", "segment"])
@pytest.mark.parametrize("kind", ["session", "pictures", "notes"])
def test_folder_that_no_command_wrote_is_refused(session: Path, tmp_path: Path, command: str, kind: str) -> None:
    out = tmp_path / "mine"
    if kind == "session":
        shutil.copytree(DEMO, out)
    else:
        out.mkdir()
        name = "0001.png" if kind == "pictures" else "run.json"
        (out / name).write_text("mine")
    before = content(out)
    for more in ((), ("--overwrite",)) if command == "batch" else ((),):
        refusal = run(command, session, "--out", out, *more).refusal
        assert refusal.startswith(f"{out}")
    assert content(out) == before


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
    ran = again(kept, tmp_path / "out", "--frames", "0001", "--workers", 1)
    assert ran.code in (0, 3)
    assert (tmp_path / "disk" / "frames" / "0001.json").is_file()


@pytest.mark.parametrize("name", ["../evil", "a/b", ".hidden"])
def test_name_of_a_frame_cannot_lead_out_of_the_folder(tmp_path: Path, name: str) -> None:
    readings = "wrist_pitch=-0.2,wrist_yaw=0.55,jaw=0.83"
    words = ("estimate", *FRAME[:4], "--joints", readings, "--frame", name, "--out", tmp_path / "x" / "out")
    assert name in run(*words).refusal
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
