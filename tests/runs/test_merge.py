"""Shards and worker processes: the merged results equal those of a single run, in any order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK_CONFIG, comparable, make_session

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.output import Output, output
from dvrk_cmaes.runs.batch import BatchSummary, Workers, run_batch
from dvrk_cmaes.runs.merge import merge_shards
from dvrk_cmaes.runs.worklist import Shard
from dvrk_cmaes.silhouette import Body

pytestmark = pytest.mark.usefixtures("estimates_shared")

NAMES = [f"{k:04d}" for k in range(5)]
Batch = Callable[..., BatchSummary]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_session(tmp_path_factory.mktemp("session") / "five", NAMES)
    (folder / "masks" / "0003.png").write_bytes(b"nonsense")
    return folder


@pytest.fixture(scope="module")
def thread() -> Iterator[Executor]:
    with ThreadPoolExecutor(1) as executor:
        yield executor


@pytest.fixture
def batch(session: Path, bundled_body: Body, thread: Executor) -> Batch:
    def go(out: Path, **options: object) -> BatchSummary:
        given = {"config": QUICK_CONFIG, "workers": Workers(executor=thread), **options}
        return run_batch(read_session(session), out, bundled_body.instrument, **given)  # type: ignore[arg-type]

    return go


@pytest.fixture(scope="module")
def whole(
    session: Path, bundled_body: Body, thread: Executor, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    """Run the batch in one thread of this process; gives its files."""
    out = tmp_path_factory.mktemp("whole") / "out"
    run_batch(
        read_session(session), out, bundled_body.instrument, config=QUICK_CONFIG, workers=Workers(executor=thread)
    )
    return comparable(out)


def test_two_processes_agree_with_one_thread(batch: Batch, whole: dict[str, str], tmp_path: Path) -> None:
    done = batch(tmp_path / "out", workers=Workers(2))
    assert (done.ran, done.counts["failed"]) == (5, 1)
    assert comparable(tmp_path / "out") == whole


def test_merged_shards_agree_with_single_run(batch: Batch, whole: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    part = batch(out, shard=Shard(2, 3))
    assert part.folder == out / "shards" / "2-of-3"
    assert part.counts["frames"] == part.ran == 2
    assert not (part.folder / "poses.csv").exists()
    assert [batch(out, shard=Shard(k, 3)).ran for k in (3, 2, 1)] == [1, 0, 2]
    assert merge_shards(out)["counts"]["missing"] == 0
    assert comparable(out) == whole
    assert not (out / "shards").exists()
    merge_shards(out)
    assert comparable(out) == whole


def test_incomplete_shards_may_be_merged(batch: Batch, whole: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch(out, shard=Shard(1, 2))
    assert merge_shards(out)["missing"] == ["0001", "0003"]
    assert batch(out, shard=Shard(1, 2)).ran == 0
    assert batch(out, shard=Shard(2, 2)).ran == 2
    assert merge_shards(out)["missing"] == []
    assert comparable(out) == whole


def test_interrupted_merge_is_completed(
    batch: Batch, whole: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    for k in (1, 2):
        batch(out, shard=Shard(k, 2))
    moved: list[str] = []

    def interrupted(own: Output, other: Output, name: str) -> None:
        if moved:
            raise KeyboardInterrupt
        move_from(own, other, name)
        moved.append(name)

    move_from = Output.move_from
    monkeypatch.setattr(Output, "move_from", interrupted)
    with pytest.raises(KeyboardInterrupt):
        merge_shards(out)
    monkeypatch.undo()
    assert moved == ["overlays/0000.jpg"]
    merge_shards(out)
    assert comparable(out) == whole


def test_run_after_merge_estimates_missing_frames(batch: Batch, whole: dict[str, str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch(out, shard=Shard(1, 2))
    with pytest.raises(InputError) as caught:
        batch(out)
    assert str(caught.value) == (f"{out}: it has shards that are not merged; run dvrk-cmaes batch --merge {out} first")
    merge_shards(out)
    assert batch(out).ran == 2
    assert comparable(out) == whole


def test_shards_with_other_settings_are_not_merged(batch: Batch, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch(out, shard=Shard(1, 2))
    batch(out, shard=Shard(2, 2), arm="si")
    with pytest.raises(InputError) as caught:
        merge_shards(out)
    assert str(caught.value) == (
        f"{out / 'shards' / '2-of-2'}: its results were made otherwise (arm: classic -> si): "
        "choose another --out, or begin anew with --overwrite"
    )
    assert not (out / "frames").exists()


def test_damaged_result_is_refused_before_anything_is_merged(batch: Batch, tmp_path: Path) -> None:
    out = tmp_path / "out"
    batch(out, shard=Shard(1, 2))
    merge_shards(out)
    batch(out, shard=Shard(2, 2))
    (out / "frames" / "0002.json").write_text("{")
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    with pytest.raises(InputError, match=r"0002\.json"):
        merge_shards(out)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()} == {
        path: time for path, time in before.items() if path.is_file()
    }


@pytest.mark.parametrize("shards", [1, 2])
def test_damaged_summary_is_replaced_by_a_merge(
    batch: Batch, whole: dict[str, str], tmp_path: Path, shards: int
) -> None:
    out = tmp_path / "out"
    for k in range(shards):
        batch(out, shard=Shard(k + 1, shards))
        merge_shards(out)
        (out / "summary.json").write_bytes(b"{")
    merge_shards(out)
    assert comparable(out) == whole


def test_shard_in_use_is_not_merged(batch: Batch, tmp_path: Path) -> None:
    out = tmp_path / "out"
    part = batch(out, shard=Shard(1, 2)).folder
    with output(part, "batch"), pytest.raises(DvrkCmaesError, match="another command is writing there"):
        merge_shards(out)
    with pytest.raises(InputError, match="expected results of dvrk-cmaes batch --shard, got none"):
        merge_shards(tmp_path)


def test_shards_may_be_empty(batch: Batch, tmp_path: Path) -> None:
    assert batch(tmp_path / "out", shard=Shard(7, 7)).counts["frames"] == 0
    assert merge_shards(tmp_path / "out")["missing"] == NAMES


@pytest.mark.parametrize("text", ["0/2", "3/2", "2", "1/0", "-1/2", "1/2/3", "1.5/2", ""])
def test_shard_syntax(text: str) -> None:
    with pytest.raises(InputError) as caught:
        Shard.parse(text)
    assert str(caught.value) == f"--shard: expected I/N with I from 1 to N, e.g. 2/8, got {text!r}"
    assert Shard.parse("2/8") == Shard(2, 8)


def test_each_frame_belongs_to_one_shard(session: Path) -> None:
    frames = read_session(session).frames
    parts = [part for k in (1, 2, 3) for part in Shard(k, 3).part(frames)]
    assert sorted(files.name for files in parts) == NAMES
