"""The tutorial's commands, run as printed and in their order in an empty folder, and what it shows of their output."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.places import ROOT
from helpers.plain_pictures import plain_pictures
from helpers.printed_blocks import Block, blocks, has_in_order, printed_parts, run, words
from helpers.processes_here import processes_here
from helpers.shared_estimates import shared_estimates

BLOCKS = list(blocks((ROOT / "data" / "reference" / "tutorial.md").read_text(encoding="utf-8")))
CAMERA, REST = BLOCKS[0], BLOCKS[1:]


def test_blocks_are_a_camera_commands_and_what_they_print() -> None:
    assert CAMERA.text.startswith("width: 400\n")
    shells = [block for block in REST if block.commands]
    assert len(shells) == 8
    assert [block for block in shells if len(block.commands) != len(block.lines)] == []
    printed = [block for block in REST if not block.commands]
    assert len(printed) == 4
    assert all(REST[REST.index(block) - 1].commands for block in printed)


def test_commands_run_as_printed_and_print_what_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("camera.yaml").write_text(CAMERA.text, encoding="utf-8")
    output: list[str] = []
    for block in REST:
        if block.commands:
            with processes_here(), shared_estimates(), plain_pictures():
                output = [line for command in block.commands for line in words(_said(command))]
        else:
            assert has_in_order(output, printed_parts(block.text)), (block.text, output)
    named = {path for block in REST for path in re.findall(r"(?<=written: )\S+", block.text)}
    assert {"calibrated/session.json"} <= named
    for path in (*named, "alone/report.html", "tracks/tracks.mp4", "tracks/report.html"):
        assert Path(path).is_file()


def _said(command: str) -> str:
    """Run a command, which may end with doubts, and return what it printed."""
    ran = run(command)
    assert ran.code in (0, 3), (command, ran.err)
    return ran.out


def test_a_block_that_differs_is_found() -> None:
    shown = printed_parts(Block("", "12 frames: 12 ok\n...\nmedians: IoU 0.9").text)
    assert has_in_order(words("x\n3 frames: 2 ok\ny\nmedians: IoU 1"), shown)
    assert not has_in_order(words("x\n3 frames: 2 ok\ny\nmedian: IoU 1"), shown)
    assert not has_in_order(words("medians: IoU 1\n3 frames: 2 ok"), shown)
