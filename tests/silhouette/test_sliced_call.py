"""A call in slices: its value, its slices, what it raises, and giving it up."""

from __future__ import annotations

import gc
import threading

import pytest

from dvrk_cmaes.silhouette.sliced_call import SlicedCall, worked


def drawing(times: int, done: list[int]) -> int:
    for k in range(times):
        worked(900)
        done.append(k)
    return times


def test_call_is_done_in_slices_that_only_its_work_decides() -> None:
    done: list[int] = []
    call = SlicedCall(lambda: drawing(7, done))
    assert done == []
    counts = []
    while not call.advance(3000):
        counts.append(len(done))
    assert counts == [2, 5]  # the third drawing of each slice waits for the next one
    assert call.value() == 7


def test_error_is_raised_where_the_value_is_asked_for() -> None:
    def fails() -> int:
        worked(1)
        raise ValueError("of the call")

    call = SlicedCall(fails)
    assert call.advance(1e9)
    with pytest.raises(ValueError, match="of the call"):
        call.value()


def test_call_that_is_not_wanted_any_more_ends_its_thread() -> None:
    before = threading.active_count()
    call = SlicedCall(lambda: drawing(10**9, []))
    assert not call.advance(3000)
    assert threading.active_count() == before + 1
    del call
    gc.collect()
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and thread.name.endswith("(_run)"):
            thread.join(10)
    assert threading.active_count() == before
