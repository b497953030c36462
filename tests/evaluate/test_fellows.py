"""A frame whose base lies far from that of its session's other frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from helpers.canned_results import canned

from dvrk_cmaes.evaluate.fellows import PREFIX, base_doubts
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.results.result import Result

BASE = moved(np.eye(4), np.array([0.1, 0.0, 0.05, 0.3, -0.8, 1.0]))


def session(turns_deg: list[float]) -> dict[str, Result]:
    found = {}
    for k, turn in enumerate(turns_deg):
        name = f"{k:04d}"
        base = moved(BASE, np.array([0, 0, 0, 0, np.deg2rad(turn), 0]))
        found[name] = replace(canned(name), camera_from_base=base)
    return found


def test_frame_apart_is_named_with_its_angle() -> None:
    doubts = base_doubts(session([0, 1, -1, 2, 0.5, 40]), 10.0)
    assert list(doubts) == ["0005"]
    assert doubts["0005"].startswith(f"{PREFIX}: rotated by 39 deg, expected at most 10 deg")


def test_frames_that_agree_are_not_doubted() -> None:
    assert base_doubts(session([0, 1, -1, 2, 0.5, 8]), 10.0) == {}


def test_limit_grows_with_scatter_of_session() -> None:
    assert base_doubts(session([0, 6, -6, 7, -7, 6, -15]), 10.0) == {}


def test_few_frames_and_frames_without_base_are_not_compared() -> None:
    assert base_doubts(session([0, 0, 0, 40]), 10.0) == {}
    without = {name: replace(one, camera_from_base=None) for name, one in session([0, 1, 2, 3, 4, 40]).items()}
    assert base_doubts(without, 10.0) == {}


def test_frames_solved_together_are_not_compared() -> None:
    together = {name: replace(one, source="session") for name, one in session([0, 1, 2, 3, 4, 40]).items()}
    assert base_doubts(together, 10.0) == {}
