"""A pose can be estimated in a thread whose stack is small, as those of some robots' middleware are."""

from __future__ import annotations

import threading

from helpers.places import bundled_path

from dvrk_cmaes import EstimateConfig, Result, estimate, read_frame, read_session

_SMALL = 256 * 1024  # bytes


def test_estimate_runs_on_a_stack_of_256_kib() -> None:
    session = read_session(bundled_path("demo"))
    data = read_frame(session.frames[0], session.rig)
    found: list[Result] = []

    def run() -> None:
        found.append(estimate(data.mask, data.camera, session.frames[0].readings, config=EstimateConfig(threads=2)))

    before = threading.stack_size(_SMALL)
    try:
        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
    finally:
        threading.stack_size(before)
    assert [result.status for result in found] == ["ok"]
