"""The examples in scripts/examples: they run, print what they are to show, and need public names only."""

from __future__ import annotations

import ast
import inspect
import json
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest
from helpers.commands import main
from helpers.places import ROOT, SCRIPTS

import dvrk_cmaes

pytestmark = pytest.mark.usefixtures("estimates_shared")

OF_ROS = {"__init__", "live_launch", "play_session", "sam2_mask_node"}  # of tests/live/test_page.py
EXAMPLES = sorted(path for path in (SCRIPTS / "examples").glob("*.py") if path.stem not in OF_ROS)


def run(name: str, monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    """Run an example with arguments, as Python runs a script."""
    path = str(SCRIPTS / "examples" / name)
    monkeypatch.setattr(sys, "argv", [path, *map(str, arguments)])
    runpy.run_path(path, run_name="__main__")


def test_frame_is_estimated_from_arrays(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    run("estimate_frame.py", monkeypatch)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "status: ok"
    assert re.fullmatch(r"wrist_yaw: found \+0\.6[78]\d rad, read \+0\.557 rad", lines[3])
    assert re.fullmatch(r"tips within \d\.\d+ mm \(90 %, \d\.\d+ mm given the camera\)", lines[-1])


def test_recording_is_followed_to_its_last_image(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split("synth recording --motion video --level easy --frames 3 --seed 1 --no-images")) == 0
    capsys.readouterr()
    run("follow_recording.py", monkeypatch, "recording")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(",")[0] for line in lines[:3]] == ["0000: doubtful", "0001: doubtful", "0002: doubtful"]
    assert all("base" in line for line in lines[:3])  # too few images to know it
    assert ast.literal_eval(lines[3].partition(": ")[2]) == {}


def test_session_is_calibrated_and_used(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run("calibrate_session.py", monkeypatch, ROOT / "data" / "demo", tmp_path / "session.json")
    out = capsys.readouterr().out
    assert out.startswith("ok: 5 frames agree\n")
    assert out.endswith("0000 with the calibration: ok, solved from the session\n")
    assert dvrk_cmaes.read_calibration(tmp_path / "session.json").frames == ("0000", "0001", "0002", "0003", "0004")


def test_two_tools_are_estimated_and_read_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split("synth both --arms 2 --level easy --frames 1 --seed 2")) == 0
    capsys.readouterr()
    run("two_tools.py", monkeypatch, "both", "results")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines if line.startswith("PSM")] == ["PSM1", "PSM2"]
    assert sum(re.fullmatch(r"  depth of the wrist: \d+\.\d mm", line) is not None for line in lines) == 2


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        (
            "follow_recording.py",
            [],
            "expected a session folder with consecutive masks, and with times in its joints.csv",
        ),
        ("follow_recording.py", [ROOT / "data" / "demo"], "times in joints.csv, got no time of 0000"),
        ("two_tools.py", ["both"], "expected a session folder of two arms, and a folder to write to"),
        ("two_tools.py", ["no", "where"], "No such file or directory: 'no/joints_PSM1.csv'"),
        (
            "calibrate_session.py",
            [],
            "expected a session folder with readings of the outer joints, and the file to write",
        ),
        ("calibrate_session.py", ["no", "where"], "no: "),
    ],
)
def test_example_without_what_it_needs_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, arguments: list[Path], expected: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(name, monkeypatch, *arguments)
    assert ended.value.code == 2
    printed = capsys.readouterr()
    (line,) = [line for line in printed.err.splitlines() if "imread" not in line]
    assert expected in line


def test_examples_and_notebook_call_every_public_function() -> None:
    notebook = json.loads((SCRIPTS / "examples" / "folder_to_plots.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    trees = [ast.parse(text) for text in (*cells, *(path.read_text(encoding="utf-8") for path in EXAMPLES))]
    calls = (node.func for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Call))
    called = {call.id for call in calls if isinstance(call, ast.Name)}
    functions = {name for name in dvrk_cmaes.__all__ if inspect.isfunction(getattr(dvrk_cmaes, name))}
    assert len(functions) > 8
    assert functions <= called


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_uses_public_names_alone(path: Path) -> None:
    imports = [
        node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.ImportFrom)
    ]
    own = [node for node in imports if (node.module or "").startswith("dvrk_cmaes")]
    assert [node.module for node in own] == ["dvrk_cmaes"]
    assert {name.name for node in own for name in node.names} <= set(dvrk_cmaes.__all__)
