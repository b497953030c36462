"""Batches of two arms: frames in which a tool is in front of the other are solved again, once."""

from __future__ import annotations

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG, comparable
from helpers.crossing_tools import ARMS, write_crossing_session

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.frames.tool_frames import frames_of_tool
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.batch import BatchSummary, Workers, run_batch
from dvrk_cmaes.runs.crossing_tools import solve_crossing
from dvrk_cmaes.runs.worklist import Shard
from dvrk_cmaes.silhouette import Body

CONFIG = replace(QUICK_CONFIG, refine=replace(QUICK_CONFIG.refine, modes=2))
EXECUTOR = ThreadPoolExecutor(1)


@pytest.fixture(scope="module")
def sessions(bundled_body: Body, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Session]:
    """Give a session as each of its two arms sees it."""
    folder = write_crossing_session(tmp_path_factory.mktemp("crossing") / "session", bundled_body)
    entries = read_session_toml(folder)
    assert entries is not None
    known = bundled_body.instrument.joint_names
    read = {arm: read_session(folder, known=known, joints=(folder / f"joints_{arm}.csv",)) for arm in ARMS}
    return {arm: frames_of_tool(session, entries, arm) for arm, session in read.items()}


@pytest.fixture(scope="module")
def solve(sessions: dict[str, Session], bundled_body: Body):
    """Give a function that runs the batches of both arms."""

    def run(out: Path, shard: Shard | None = None) -> dict[str, BatchSummary]:
        options = {"config": CONFIG, "workers": Workers(executor=EXECUTOR), "shard": shard}
        return {arm: run_batch(sessions[arm], out / arm, bundled_body.instrument, **options) for arm in ARMS}

    return run


@pytest.fixture(scope="module")
def first(solve, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give the results of both arms, each by itself."""
    out = tmp_path_factory.mktemp("first") / "out"
    solve(out)
    return out


@pytest.fixture(scope="module")
def finished(solve, first: Path) -> Path:
    """Give the results after the frames in which the tools cross were solved again."""
    out = first.parent / "finished"
    shutil.copytree(first, out)
    solve_crossing(solve(out), Workers(executor=EXECUTOR))
    return out


def results(batches: dict[str, BatchSummary]) -> dict[str, dict[str, Result]]:
    return {arm: batch.results for arm, batch in batches.items()}


def test_results_say_where_the_other_tool_is(solve, finished: Path) -> None:
    found = results(solve(finished))
    places = {arm: {name: one.other_tools for name, one in of_arm.items()} for arm, of_arm in found.items()}
    assert places["PSM1"] == {
        "0000": {"PSM2": "behind"},
        "0001": {"PSM2": "in front"},
        "0002": {"PSM2": "apart"},
        "0003": {},
    }
    assert places["PSM2"]["0000"] == {"PSM1": "in front"}
    assert places["PSM2"]["0001"] == {"PSM1": "behind"}
    assert found["PSM2"]["0003"].status == "failed"  # PSM2 is not in that frame


def test_only_the_tool_in_front_is_solved_again(solve, first: Path, finished: Path) -> None:
    before, after = results(solve(first)), results(solve(finished))
    for arm, front in (("PSM1", "0000"), ("PSM2", "0001")):
        for name in ("0000", "0001", "0002"):
            old, new = before[arm][name], after[arm][name]
            assert (new.evaluations > old.evaluations) == (name == front)
            same = np.array_equal(new.camera_from_root, old.camera_from_root)  # type: ignore[arg-type]
            assert same == (name != front)
        assert after[arm][front].seconds > before[arm][front].seconds


def test_same_batch_again_changes_nothing(solve, finished: Path) -> None:
    there = comparable(finished)
    progress = solve_crossing(solve(finished), Workers(executor=EXECUTOR))
    assert comparable(finished) == there
    assert not any(batch.interrupted for batch in progress.values())


def test_interrupted_run_goes_on_where_it_ended(solve, first: Path, finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(first, out)
    stop = threading.Event()
    stop.set()
    stopped = solve_crossing(solve(out), Workers(executor=EXECUTOR, stop=stop))
    assert all(batch.interrupted for batch in stopped.values())
    assert comparable(out) != comparable(finished)
    # one of the two frames is done, the other is not
    shutil.copytree(finished / "PSM1", out / "PSM1", dirs_exist_ok=True)
    solve_crossing(solve(out), Workers(executor=EXECUTOR))
    assert comparable(out) == comparable(finished)


def test_frames_whose_masks_are_gone_are_unclear(solve, first: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(first, out)
    batches = {
        arm: replace(
            batch,
            frames={name: replace(files, mask=tmp_path / "gone.png") for name, files in batch.frames.items()},
        )
        for arm, batch in solve(out).items()
    }
    found = results(solve_crossing(batches, Workers(executor=EXECUTOR)))
    assert found["PSM1"]["0000"].other_tools == {"PSM2": "unclear"}


def test_shards_are_solved_by_themselves(solve, finished: Path, tmp_path: Path) -> None:
    for number in (1, 2):
        solve_crossing(solve(tmp_path / "out", Shard(number, 2)), Workers(executor=EXECUTOR))
    whole = results(solve(finished))
    for arm in ARMS:
        files = sorted((tmp_path / "out" / arm).rglob("frames/*.json"))
        assert [path.stem for path in sorted(files, key=lambda path: path.stem)] == [*whole[arm]]
        for path in files:
            assert read_result(path).other_tools == whole[arm][path.stem].other_tools


def test_results_with_an_unknown_place_are_refused(solve, finished: Path) -> None:
    document = solve(finished)["PSM1"].results["0000"].to_dict()
    assert Result.from_dict(document).other_tools == {"PSM2": "behind"}
    with pytest.raises(InputError, match="other_tools"):
        Result.from_dict(document | {"other_tools": {"PSM2": "above"}})
