"""scripts/accuracy.py fleet: figures of followed recordings with known truth, and which folders are recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("scripts_on_path")

TRUE = [[0.0, 0.0, 0.1], [0.0, 0.002, 0.1]]


def row(frame: str, off_mm: float | None, status: str = "ok") -> dict[str, Any]:
    """Return a line of tracks.jsonl whose tips are some mm off, with a standard deviation of half a mm."""
    tips = None if off_mm is None else (np.array(TRUE) + np.array([1e-3 * off_mm, 0, 0])).tolist()
    return {"frame": frame, "status": status, "tips": tips, "std": None if tips is None else {"tip_mm": 0.5}}


def truth(visible: float) -> dict[str, Any]:
    return {"tips_camera_m": TRUE, "visible": visible}


def test_figures_are_those_of_frames_in_view() -> None:
    from measure.accuracy.fleet import TipErrors

    golden = {"a": truth(1.0), "b": truth(0.6), "c": truth(0.9), "d": truth(0.1)}
    rows = [row("a", 1.0), row("b", 2.5), row("c", None, "lost"), row("d", 50.0)]
    figures = TipErrors.of(rows, golden).figures()
    assert figures["frames"] == 3
    assert figures["tips, mm"] == pytest.approx(2.5)
    assert figures["worst"] == 1000
    assert figures["ok in view"] == 0.5
    assert figures["ok beyond 2 mm"] == 0.5
    assert figures["ok beyond 3 mm"] == 0.0
    assert figures["error / std"] == pytest.approx(3.5)


def test_recordings_are_pooled_by_frames() -> None:
    from measure.accuracy.fleet import TipErrors

    first = TipErrors.of([row("a", 1.0)], {"a": truth(1.0)})
    second = TipErrors.of([row("a", 3.0), row("b", 3.0)], {"a": truth(1.0), "b": truth(1.0)})
    assert TipErrors.pooled([first, second]).figures()["tips, mm"] == pytest.approx(3.0)


def test_recording_is_wrong_if_more_than_a_fifth_of_its_ok_frames_are_far_off() -> None:
    from measure.accuracy.fleet import TipErrors

    golden = {name: truth(1.0) for name in "abcdef"}
    rows = [row(name, 1.0) for name in "abcd"] + [row("e", 4.0), row("f", 9.0, "doubtful")]
    assert not TipErrors.of(rows, golden).wrong  # one of five
    assert TipErrors.of([*rows[1:5], row("f", 4.0)], golden).wrong
    assert not TipErrors.of([row("a", 9.0, "doubtful")], golden).wrong


def test_stated_probabilities_are_compared_with_what_happened() -> None:
    from measure.accuracy.fleet import TipErrors

    golden = {name: truth(1.0) for name in "abc"}
    rows = [row("a", 1.0) | {"tip_probability": 0.95}, row("b", 2.0) | {"tip_probability": 0.93}, row("c", None)]
    (found,) = TipErrors.of(rows, golden).reliability(1.8)
    assert (found["results"], found["near"]) == (2, 0.5)


def test_folder_of_recordings_gives_those_with_a_truth(tmp_path: Path) -> None:
    from measure.accuracy.fleet import recordings_in

    for name in ("b", "a", "without"):
        (tmp_path / name).mkdir()
    for name in ("a", "b"):
        (tmp_path / name / "golden.json").write_text("{}", encoding="utf-8")
    assert [*recordings_in([tmp_path])] == [tmp_path / "a", tmp_path / "b"]
    assert [*recordings_in([tmp_path / "b"])] == [tmp_path / "b"]
