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
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import cv2
import pytest
from helpers.waiting import wait_for, within
from helpers.worker_tasks import (
    die,
    library_threads,
    prepare_nothing,
    process_id,
    process_id_after_pause,
    refuse,
    sixteenth_of_a_second,
    squared,
    squared_after_gate,
    squared_with_faults,
    squared_with_late_faults,
)

from dvrk_cmaes import DvrkCmaesError, InputError
from dvrk_cmaes.runs.processes import Processes, WorkerConnection, WorkerDied
from dvrk_cmaes.runs.worker_process import ProcessDiedError, WorkerProcess


def run_in_processes(
    tasks: Iterable[Any],
    call: Callable[[Any], Any],
    *,
    start: Callable[[], object],
    workers: int,
    time_limit: float,
    stop: threading.Event,
) -> Iterator[tuple[Any, Any]]:
    """Run tasks in processes that end with them."""
    with Processes(start, workers) as processes:
        yield from processes.run(tasks, call, time_limit=time_limit, stop=stop)


def run(call: Callable[[int], int], tasks: range, **changes: object) -> dict[int, int | WorkerDied]:
    options = {"start": prepare_nothing, "workers": 2, "time_limit": 60.0, "stop": threading.Event(), **changes}
    return dict(run_in_processes(tasks, call, **options))  # type: ignore[arg-type]


def test_dead_or_hanging_process_loses_its_task_only(tmp_path: Path) -> None:
    found = run(functools.partial(squared_with_faults, tmp_path), range(1, 13), time_limit=3.0)
    lost = {task: value.reason for task, value in found.items() if isinstance(value, WorkerDied)}
    assert lost == {
        7: "its process died 2 times: out of memory, or a crash in a native library",
        11: "no result after 3 s: its process was ended",
    }
    assert {task: value for task, value in found.items() if task not in lost} == {
        task: task * task for task in range(1, 13) if task not in lost
    }
    tries = {task: len((tmp_path / str(task)).read_text().split()) for task in range(1, 13)}
    assert tries == dict.fromkeys(range(1, 13), 1) | {5: 2, 7: 2}
    wait_for(lambda: not multiprocessing.active_children())


@pytest.fixture
def count_calls(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Give a list to which each call of a worker process is appended."""
    calls: list[object] = []
    call = WorkerProcess.call

    def counted(process: WorkerProcess, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        calls.append(arguments)
        return call(process, function, *arguments, **options)

    monkeypatch.setattr(WorkerProcess, "call", counted)
    return calls


def test_short_tasks_are_sent_together(count_calls: list[object]) -> None:
    assert run(squared, range(1000)) == {task: task * task for task in range(1000)}
    assert len(count_calls) < 400


def test_longer_tasks_are_sent_one_by_one(count_calls: list[object]) -> None:
    assert len(run(sixteenth_of_a_second, range(8))) == 8
    assert len(count_calls) == 8 + 2  # and the start of each process


def test_fault_among_short_tasks_loses_its_task_only() -> None:
    found = run(squared_with_late_faults, range(200), time_limit=2.0)
    lost = {task: value.reason for task, value in found.items() if isinstance(value, WorkerDied)}
    assert lost == {
        150: "its process died 2 times: out of memory, or a crash in a native library",
        170: "no result after 2 s: its process was ended",
    }
    assert {task: value for task, value in found.items() if task not in lost} == {
        task: task * task for task in range(200) if task not in lost
    }


def test_processes_dying_at_start_end_work_with_reason() -> None:
    with pytest.raises(DvrkCmaesError) as caught:
        run(squared, range(3), start=die, workers=1)
    assert str(caught.value) == (
        "worker processes died 3 times at their start: out of memory? Try fewer workers; "
        "what is done is kept, and the same command goes on from there"
    )


def test_stop_finishes_running_tasks(tmp_path: Path) -> None:
    stop, gate = threading.Event(), tmp_path / "gate"
    tasks = [(number, gate) for number in range(100)]
    found = run_in_processes(tasks, squared_after_gate, start=prepare_nothing, workers=2, time_limit=60, stop=stop)
    assert next(found) == ((0, gate), 0)
    stop.set()
    gate.touch()
    rest = dict(found)
    assert len(rest) <= 2
    assert all(value == number * number for (number, _), value in rest.items())


def test_closed_generator_ends_processes() -> None:
    found = run_in_processes(
        range(100),
        functools.partial(time.sleep),
        start=prepare_nothing,
        workers=2,
        time_limit=60,
        stop=threading.Event(),
    )
    next(found)
    with within(20):
        found.close()  # type: ignore[attr-defined]
    wait_for(lambda: not multiprocessing.active_children())


def test_processes_stay_for_several_runs() -> None:
    with Processes(prepare_nothing, 1) as processes:
        first, second = (dict(processes.run(range(2), process_id)) for _ in range(2))
        assert {*first.values(), *second.values()} == {one.pid for one in multiprocessing.active_children()}
    assert not multiprocessing.active_children()


def test_this_process_does_tasks_as_well() -> None:
    with Processes(prepare_nothing, 1, here=True) as processes:
        processes.begin()
        found: set[int | WorkerDied] = set()
        while len(found) < 2:
            found |= {*dict(processes.run(range(50), process_id_after_pause)).values()}
        assert found == {os.getpid(), *(one.pid for one in multiprocessing.active_children())}
    assert not multiprocessing.active_children()


def test_this_process_alone_starts_no_other() -> None:
    with Processes(prepare_nothing, 0, here=True) as processes:
        processes.begin()
        assert dict(processes.run(range(3), process_id)) == dict.fromkeys(range(3), os.getpid())
        assert not multiprocessing.active_children()


def test_processes_that_were_begun_and_not_used_end() -> None:
    with Processes(prepare_nothing, 2) as processes:
        processes.begin()
    assert not multiprocessing.active_children()


def test_a_process_that_ends_while_it_is_begun_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that begins it notices first that it was killed, and waits for its end, which takes a while."""
    end = WorkerConnection.end

    def noticed_first(process: WorkerProcess, *_: object, **__: object) -> None:
        raise ProcessDiedError

    def end_late(process: WorkerConnection) -> None:
        end(process)
        time.sleep(0.02)

    monkeypatch.setattr(WorkerProcess, "call", noticed_first)
    monkeypatch.setattr(WorkerProcess, "kill", lambda process: None)  # it ends with its pipe
    monkeypatch.setattr(WorkerConnection, "end", end_late)
    with Processes(prepare_nothing, 1) as processes:
        processes.begin()
        while not multiprocessing.active_children():
            time.sleep(0.01)
    assert not multiprocessing.active_children()


def test_error_in_this_process_ends_workers() -> None:
    with pytest.raises(InputError, match="refused 0"), Processes(prepare_nothing, 1, here=True) as processes:
        list(processes.run(range(1), refuse))
    assert not multiprocessing.active_children()


def test_libraries_use_one_thread_meanwhile() -> None:
    before = cv2.getNumThreads()
    with Processes(prepare_nothing, 0, here=True) as processes:
        assert dict(processes.run(range(1), library_threads)) == {0: 1}
    assert cv2.getNumThreads() == before


def test_exception_of_task_is_raised_with_place_in_worker() -> None:
    with pytest.raises(InputError) as caught:
        run(refuse, range(3, 4))
    assert str(caught.value) == "refused 3"
    assert "worker_tasks.py" in "".join(caught.value.__notes__)
    assert not multiprocessing.active_children()


def test_nothing_is_left_to_resource_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    registered: list[str] = []
    monkeypatch.setattr(resource_tracker, "register", lambda name, kind: registered.append(name))
    assert run(squared, range(3)) == {0: 0, 1: 1, 2: 4}
    assert registered == []


ORPHANS = """
import os, pathlib, sys, time
from dvrk_cmaes.runs.processes import Processes

def sleep(task):
    pathlib.Path(sys.argv[1], str(os.getpid())).touch()
    time.sleep(100)

def nothing():
    pass

if __name__ == "__main__":
    with Processes(nothing, 2) as processes:
        list(processes.run(range(2), sleep, time_limit=200))
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
