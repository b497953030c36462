"""``dvrk-cmaes compare``: table, files, picture and page of the differences between results."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from helpers.canned_results import canned, failed, write_results
from helpers.commands import Ran, run_command
from helpers.files import write_image
from helpers.page_results import Page, overlay
from helpers.transforms import moved

Run = Callable[..., Ran]
FRAMES = {"0000": 0.5, "0001": 4.0, "0002": 1.0}


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``dvrk-cmaes compare``."""
    return partial(run_command, capsys, "compare")


@pytest.fixture
def sets(tmp_path: Path) -> tuple[Path, Path]:
    """Write two sets of results, the poses of the second 0.5, 4 and 1 mm aside."""
    before = write_results(tmp_path / "before", *(canned(name, k) for k, name in enumerate(FRAMES)), failed("0003"))
    after = []
    for k, (name, mm) in enumerate(FRAMES.items()):
        one = canned(name, k)
        assert one.camera_from_root is not None
        after.append(replace(one, camera_from_root=moved(one.camera_from_root, [mm / 1e3, 0, 0, 0, 0, 0])))
    for one in after:
        write_image(tmp_path / "after" / "overlays" / f"{one.frame}.jpg", overlay(one))
    return before, write_results(tmp_path / "after", *after)


def test_table_has_sums_and_frames_by_size(run: Run, sets: tuple[Path, Path]) -> None:
    ran = run(*sets)
    assert (ran.code, ran.err) == (0, "")
    lines = [line.split() for line in ran.out.splitlines()]
    assert next(line[2:] for line in lines if line[:2] == ["tips,", "mm"]) == ["1.000", "3.700", "4.000", "0001"]
    assert [line[0] for line in lines if line[0] in FRAMES] == ["0001", "0002", "0000"]


def test_fewer_frames_are_shown_and_counted(run: Run, sets: tuple[Path, Path]) -> None:
    out = run(*sets, "--frames", 1).out
    assert "and 2 frames that differ less (--frames 0 shows all)" in out
    assert "0002" in run(*sets, "--frames", 0).out


def test_frames_of_equal_numbers_are_compared_and_named(run: Run, sets: tuple[Path, Path], tmp_path: Path) -> None:
    again = write_results(tmp_path / "again", *(canned(f"00{name}", k) for k, name in enumerate(FRAMES)))
    ran = run(sets[0], again, "--out", tmp_path / "out")
    assert "paired by their numbers: 3 frames, such as 000000 with 0000 of A" in ran.out


def test_json_has_all_frames(run: Run, sets: tuple[Path, Path]) -> None:
    document = run(*sets, "--json").result
    assert document["reference"] == "A"
    assert document["sets"]["B"]["differences"]["root_mm"]["frame"] == "0001"
    assert document["frames"]["0001"]["B"]["root_mm"] == pytest.approx(4)
    assert document["frames"]["0003"] == {"A": {"status": "failed", "iou": None}}


def test_files_are_written(run: Run, sets: tuple[Path, Path], tmp_path: Path) -> None:
    ran = run(*sets, "--out", tmp_path / "out")
    assert ran.code == 0
    rows = list(csv.DictReader((tmp_path / "out" / "compare.csv").read_text().splitlines()))
    assert [(row["frame"], row["set"]) for row in rows] == [(frame, "B") for frame in FRAMES]
    assert float(rows[1]["tips, mm"]) == pytest.approx(4, abs=1e-4)
    page = Page((tmp_path / "out" / "compare.html").read_text(encoding="utf-8"))
    assert [address for address in page.addresses if not address.startswith(("data:", "#"))] == []
    assert sum(address.startswith("data:image/webp") for address in page.addresses) == 3
    for text in ("4 frames · differences from A", "tips, mm 1.000 3.700 4.000 0001", "largest difference first"):
        assert text in page.text


def test_wrong_usage_is_refused(run: Run, sets: tuple[Path, Path]) -> None:
    assert run(sets[0]).refusal == "RESULTS: expected at least two sets of poses to compare, got 1"
    assert run(*sets, "--frames", -1).refusal == "--frames: expected a whole number of at least 0, got -1"
