"""A batch on a Dask cluster: a scheduler with two worker processes, one of which is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK, QUICK_CONFIG, comparable, make_session
from helpers.commands import main
from helpers.places import ROOT, TESTS
from helpers.waiting import wait_for
from helpers.worker_tasks import squared_unless_three

from dvrk_cmaes import Body, DvrkCmaesError, InputError, read_session
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.runs.batch import run_batch
from dvrk_cmaes.runs.cluster import dask_executor
from dvrk_cmaes.runs.frame import ArmInSession
from dvrk_cmaes.runs.pool import Executors, WorkerDied, Workers, run

NAMES = [f"{k:04d}" for k in range(8)]

ENVIRONMENT = {
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(ROOT), str(TESTS)]),
    "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
}
"""Lets workers import this checkout and ``helpers.worker_tasks``; a task that has killed two of them is given up."""


class Cluster:
    """A scheduler and its workers, each in its own process."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file = folder / "scheduler.json"
        self._processes = [self._start("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", self._file)]
        wait_for(lambda: self._file.exists() and self._file.read_text(), 300)
        self.address: str = json.loads(self._file.read_text())["address"]
        self.workers = [self.add_worker() for _ in range(2)]

    def add_worker(self) -> subprocess.Popen[bytes]:
        place = ("--scheduler-file", self._file, "--local-directory", self._folder)
        return self._start("worker", *place, "--nthreads", "1", "--no-nanny", "--no-dashboard")

    def _start(self, role: str, *options: object) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", role, *map(str, options)]
        with (self._folder / "cluster.log").open("ab") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=self._folder, env=ENVIRONMENT)
        if role == "worker":
            self._processes.append(process)
        return process

    def end(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    started = Cluster(tmp_path_factory.mktemp("cluster"))
    yield started
    started.end()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_session(tmp_path_factory.mktemp("session") / "eight", NAMES)


class KillHalfWay:
    """Kill a process when half of the frames are done."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    def __call__(self, done: int, todo: int, more: str = "") -> None:
        if done == len(NAMES) // 2:
            self._process.send_signal(signal.SIGKILL)


def test_killed_worker_does_not_change_results(
    cluster: Cluster, session: Path, bundled_body: Body, tmp_path: Path
) -> None:
    arm = ArmInSession(read_session(session), bundled_body, FrameMethod("classic", QUICK_CONFIG))
    with dask_executor(cluster.address, session) as external:
        workers = Workers(executor=external, report=KillHalfWay(cluster.workers[1]))
        done = run_batch(arm, tmp_path / "cluster", workers=workers)
    assert cluster.workers[1].wait() == -signal.SIGKILL
    assert cluster.workers[0].poll() is None
    failed = [frame["reasons"] for frame in done.document["frames"].values() if frame["status"] == "failed"]
    assert (done.ran, done.document["counts"]["missing"], failed) == (len(NAMES), 0, [])
    with ThreadPoolExecutor(1) as here:
        run_batch(arm, tmp_path / "here", workers=Workers(executor=here))
    assert comparable(tmp_path / "cluster") == comparable(tmp_path / "here")


def test_command_uses_scheduler(
    cluster: Cluster, session: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "quick.toml").write_text(QUICK)
    options = ["--config", str(tmp_path / "quick.toml"), "--frames", "000[01]", "--out", str(tmp_path / "out")]
    assert main(["batch", str(session), *options, "--scheduler", cluster.address, "--json"]) in (0, 3)
    assert json.loads(capfd.readouterr().out)["counts"]["frames"] == 2


def test_task_that_kills_every_worker_is_given_up(cluster: Cluster, session: Path) -> None:
    for _ in range(2):
        cluster.add_worker()
    with dask_executor(cluster.address, session) as external:
        found = dict(run(external, range(6), squared_unless_three))
    lost = found.pop(3)
    assert isinstance(lost, WorkerDied)
    assert lost.reason.startswith("its worker died, more than once: out of memory, or a crash in a native library (")
    assert found == {0: 0, 1: 1, 2: 4, 4: 16, 5: 25}


def test_workers_without_session_folder_are_refused(cluster: Cluster, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught, dask_executor(cluster.address, tmp_path / "nowhere"):
        pass
    assert str(caught.value).startswith("--scheduler: worker tcp://")
    assert str(caught.value).endswith(f" does not see {tmp_path / 'nowhere'}: expected it under the same path")


def test_executor_shutdown_ends_work_with_reason() -> None:
    executor = ThreadPoolExecutor(1)
    found = run(Executors(executor, lambda: 2), iter(range(10)), abs)
    next(found)
    executor.shutdown()
    with pytest.raises(DvrkCmaesError) as caught:
        list(found)
    assert str(caught.value) == (
        "the workers were lost (cannot schedule new futures after shutdown): "
        "what is done is kept, and the same command goes on from there"
    )


def test_executor_whose_process_dies_ends_work_with_reason() -> None:
    match = "the workers were lost"
    with ProcessPoolExecutor(1, get_context("spawn")) as executor, pytest.raises(DvrkCmaesError, match=match):
        list(run(Executors(executor, lambda: 2), range(10), squared_unless_three))
