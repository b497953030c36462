"""Processes of a calibration: as many as its frames need."""

from __future__ import annotations

import multiprocessing
import os

import pytest
from helpers.worker_tasks import process_id

from dvrk_cmaes import Body
from dvrk_cmaes.runs.instrument_processes import instrument_processes, processes_beside


@pytest.mark.parametrize(("workers", "frames", "beside"), [(2, 3, 0), (2, 10, 1), (1, 1000, 0), (8, 10, 2)])
def test_processes_are_as_many_as_pay(workers: int, frames: int, beside: int) -> None:
    assert processes_beside(workers, frames) == beside


def test_few_frames_start_no_process(bundled_body: Body) -> None:
    with instrument_processes(bundled_body.instrument, 8, range(3)) as processes:
        processes.begin()
        assert dict(processes.run(range(3), process_id)) == dict.fromkeys(range(3), os.getpid())
        assert not multiprocessing.active_children()
