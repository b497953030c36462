"""scripts/bench.py steps: the time of each step of a running tracker."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from helpers.commands import Ran
from helpers.moving_worlds import SMALL

from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.track.unknown_base import STEP_OF_SEARCH


def test_longest_steps_are_listed(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    frames = 14
    folder = tmp_path / "session"
    write_recording(folder, SessionPlan(prepare("lnd"), SMALL, LEVELS["clean"], "video", frames, 2, {}))
    options = ("--instrument", "lnd", "--sessions", folder, "--slowest", "3", "--repeats", "2", "--json")
    done = run_here("bench", "steps", *options)
    assert done.code == 0, done.err
    one, every = done.result["processor time of a step, ms"]
    assert (one.pop("session"), every.pop("session")) == ("session", "all")
    assert one == every
    assert one["steps"] == frames
    assert 0 < one["median"] <= one["95 %"] <= one["worst"]
    assert 0 < one["most rows"] <= 3 * STEP_OF_SEARCH + 16 * SMALL.height + 100
    slowest = done.result["the slowest"]
    assert [row["ms"] for row in slowest] == sorted((row["ms"] for row in slowest), reverse=True)
    assert slowest[0]["ms"] == one["worst"]
    assert any("searching" in row["reasons"] for row in slowest)
