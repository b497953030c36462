"""The tutorial's commands, run as printed and in their order in an empty folder, and what it shows of their output."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.places import ROOT
from helpers.plain_pictures import plain_pictures, small_overlays
from helpers.printed_blocks import LEFT_OUT, Block, blocks, has_in_order, printed_parts, run, words
from helpers.processes_here import processes_here
from helpers.shared_estimates import shared_estimates, short_searches

BLOCKS = list(blocks((ROOT / "data" / "reference" / "tutorial.md").read_text(encoding="utf-8")))
CAMERA, REST = BLOCKS[0], BLOCKS[1:]
NUMBER = re.compile(r"(?<!\S)[-+]?(?!0\d)\d+(?:\.\d+)?")
"""A number of a line; names of frames, such as 0035, are none."""


def test_blocks_are_a_camera_commands_and_what_they_print() -> None:
    assert CAMERA.text.startswith("width: 400\n")
    shells = [block for block in REST if block.commands]
    assert len(shells) == 8
    assert [block for block in shells if len(block.commands) != len(block.lines)] == []
    printed = [block for block in REST if not block.commands]
    assert len(printed) == 5
    assert all(REST[REST.index(block) - 1].commands for block in printed)


def test_commands_run_as_printed_and_print_what_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("camera.yaml").write_text(CAMERA.text, encoding="utf-8")
    output, said = list[str](), ""
    for block in REST:
        if block.commands:
            with processes_here(), shared_estimates(), short_searches(), plain_pictures(), small_overlays():
                said = "".join(map(_said, block.commands))
            output = words(said)
        else:
            assert has_in_order(output, printed_parts(block.text)), (block.text, output)
            assert far_off(block.text, said) == []
    named = {path for block in REST for path in re.findall(r"(?<=written: )\S+", block.text)}
    assert {"calibrated/session.json"} <= named
    for path in (*named, "alone/report.html", "tracks/tracks.mp4", "tracks/report.html"):
        assert Path(path).is_file()


def far_off(shown: str, said: str) -> list[tuple[str, str]]:
    """Give the lines with a number that differs by more than the tutorial says that other processors may differ by."""
    wrong = []
    lines = iter(said.splitlines())
    for line in shown.splitlines():
        if not line.strip() or line.startswith("written: ") or line == LEFT_OUT:
            continue
        (like,) = words(line)
        found = next(each for each in lines if words(each) == [like])
        pairs = zip(map(float, NUMBER.findall(line)), map(float, NUMBER.findall(found)), strict=True)
        if any(abs(one - other) > 0.15 + min(0.25 * abs(one), 1.0) for one, other in pairs):
            wrong.append((line, found))
    return wrong


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


def test_numbers_that_differ_by_more_than_is_said_are_found() -> None:
    assert far_off("roll  -7.93 deg   std 3.48\nx 0.12", "roll  -8.05 deg   std 2.70\nx 0.26") == []
    assert far_off("roll  -7.93 deg   std 1.40", "roll  -7.93 deg   std 3.48") != []
    assert far_off("lag 90", "lag 92") != []


def test_tutorial_says_by_how_much_numbers_may_differ() -> None:
    text = " ".join((ROOT / "data" / "reference" / "tutorial.md").read_text(encoding="utf-8").split())
    assert "allows each number 0.15 and a quarter of its size, but at most 1.15" in text
