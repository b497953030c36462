"""The pool of worker processes: every task gets a result or is reported as lost, whatever happens to its process."""

from __future__ import annotations

import functools
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import pytest
from helpers.waiting import wait_for, within
from helpers.worker_tasks import (
    die,
    hang_in_native_code,
    library_threads,
    prepare_nothing,
    process_id,
    process_id_after_pause,
    refuse,
    squared,
    squared_after_gate,
    squared_unless_three,
    squared_with_faults,
)

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.runs.pool import Pool, WorkerDied, further_processes, run


def run_in_pool(
    call: Callable[[Any], Any],
    tasks: Iterable[Any],
    *,
    start: Callable[[], object] = prepare_nothing,
    workers: int = 2,
    time_limit: float = 60.0,
    stop: threading.Event | None = None,
) -> Iterator[tuple[Any, Any]]:
    """Run tasks in processes that end with them."""
    with Pool(start, workers) as pool:
        yield from run(pool, tasks, call, time_limit=time_limit, stop=stop)


def test_dead_or_hanging_process_loses_its_task_only(tmp_path: Path) -> None:
    found = dict(run_in_pool(functools.partial(squared_with_faults, tmp_path), range(1, 13), time_limit=3.0))
    lost = {task: value.reason for task, value in found.items() if isinstance(value, WorkerDied)}
    assert lost == {
        7: "its process died twice: out of memory, or a crash in a native library",
        11: "no result after 3 s: it was stopped",
    }
    assert {task: value for task, value in found.items() if task not in lost} == {
        task: task * task for task in range(1, 13) if task not in lost
    }
    tries = {task: len((tmp_path / str(task)).read_text().split()) for task in range(1, 13)}
    assert (tries[5], tries[7], tries[11]) == (2, 2, 1)
    assert all(tries[task] <= 3 for task in tries)  # those that were in flight with 5 and 7
    wait_for(lambda: not multiprocessing.active_children())


def test_pool_that_is_broken_before_a_call_is_submitted_is_renewed(tmp_path: Path) -> None:
    def tasks() -> Iterator[int]:
        yield 5
        wait_for(lambda: (tmp_path / "5").exists() and not multiprocessing.active_children())
        yield 6

    found = dict(run_in_pool(functools.partial(squared_with_faults, tmp_path), tasks(), workers=2))
    assert found == {5: 25, 6: 36}


def test_native_code_that_does_not_come_back_is_ended_with_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    call = functools.partial(hang_in_native_code, 1.0)
    assert dict(run_in_pool(call, range(2), time_limit=60)) == {
        0: WorkerDied("its process died twice: out of memory, or a crash in a native library"),
        1: 1,
    }


def test_processes_dying_at_start_end_work_with_reason() -> None:
    with pytest.raises(DvrkCmaesError) as caught:
        dict(run_in_pool(squared, range(3), start=die, workers=1))
    assert str(caught.value) == (
        "worker processes die at their start: out of memory? Try fewer workers; what is done is kept, and the "
        "same command goes on from there"
    )


def test_stop_finishes_running_tasks(tmp_path: Path) -> None:
    stop, gate = threading.Event(), tmp_path / "gate"
    tasks = [(number, gate) for number in range(100)]
    found = run_in_pool(squared_after_gate, tasks, stop=stop)
    assert next(found) == ((0, gate), 0)
    stop.set()
    gate.touch()
    rest = dict(found)
    assert len(rest) <= 2
    assert all(value == number * number for (number, _), value in rest.items())


def test_closed_generator_ends_processes() -> None:
    found = run_in_pool(functools.partial(time.sleep), range(100))
    next(found)
    with within(20):
        found.close()  # type: ignore[attr-defined]
    wait_for(lambda: not multiprocessing.active_children())


def test_processes_stay_for_several_runs() -> None:
    with Pool(prepare_nothing, 1) as processes:
        first, second = (dict(run(processes, range(2), process_id)) for _ in range(2))
        assert {*first.values(), *second.values()} == {one.pid for one in multiprocessing.active_children()}
    assert not multiprocessing.active_children()


def test_this_process_does_tasks_as_well() -> None:
    with Pool(prepare_nothing, 1, here=True) as processes:
        processes.begin()
        found: set[Any] = set()
        while len(found) < 2:
            found |= {*dict(run(processes, range(50), process_id_after_pause)).values()}
        assert found == {os.getpid(), *(one.pid for one in multiprocessing.active_children())}
    assert not multiprocessing.active_children()


def test_processes_that_were_begun_and_not_used_end() -> None:
    with Pool(prepare_nothing, 2) as processes:
        processes.begin()
    assert not multiprocessing.active_children()


def test_error_in_this_process_ends_workers() -> None:
    with pytest.raises(InputError, match="refused 0"), Pool(prepare_nothing, 1, here=True) as processes:
        list(run(processes, range(1), refuse))
    assert not multiprocessing.active_children()


def test_libraries_use_one_thread_meanwhile() -> None:
    before = cv2.getNumThreads()
    with Pool(prepare_nothing, 0, here=True) as processes:
        assert dict(run(processes, range(1), library_threads)) == {0: 1}
    assert cv2.getNumThreads() == before


def test_exception_of_task_is_raised_with_place_in_worker() -> None:
    with pytest.raises(InputError) as caught:
        dict(run_in_pool(refuse, range(3, 4)))
    assert str(caught.value) == "refused 3"
    assert "worker_tasks.py" in str(caught.value.__cause__)
    assert not multiprocessing.active_children()


def test_values_are_in_the_order_of_the_tasks() -> None:
    with Pool(prepare_nothing, 1) as pool:
        assert pool.values(squared, range(1000)) == [task * task for task in range(1000)]
        with pytest.raises(DvrkCmaesError, match=r"^frame 4 of 8: its process died twice.*: try fewer --workers$"):
            pool.values(squared_unless_three, range(8))


@pytest.mark.parametrize(("workers", "frames", "beside"), [(2, 3, 0), (2, 10, 1), (1, 1000, 0), (8, 10, 2)])
def test_processes_are_as_many_as_pay(workers: int, frames: int, beside: int) -> None:
    assert further_processes(workers, frames) == beside


ORPHANS = """
import os, pathlib, sys, time
from dvrk_cmaes.runs.pool import Pool, run

def sleep(task):
    pathlib.Path(sys.argv[1], str(os.getpid())).touch()
    time.sleep(100)

def nothing():
    pass

if __name__ == "__main__":
    with Pool(nothing, 2) as pool:
        list(run(pool, range(2), sleep, time_limit=200))
"""


def test_processes_end_with_killed_parent(tmp_path: Path) -> None:
    script, notes = tmp_path / "script.py", tmp_path / "processes"
    script.write_text(ORPHANS)
    notes.mkdir()
    started = subprocess.Popen([sys.executable, script, notes], stderr=subprocess.DEVNULL)
    wait_for(lambda: len(list(notes.iterdir())) == 2)
    started.kill()
    started.wait()
    wait_for(lambda: not any(is_running(int(path.name)) for path in notes.iterdir()))


def is_running(pid: int) -> bool:
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
