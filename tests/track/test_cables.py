"""What a calibrated arm's cables make a tracker expect of its readings."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from helpers.page_calibrations import cables_of, calibration, solved

from dvrk_cmaes.joints.play import play_of
from dvrk_cmaes.track.cables import CableMemory
from dvrk_cmaes.track.reading_buffer import ReadingAt

FRAMES = solved(("a", "b"))
CALIBRATED = calibration(FRAMES, cables=cables_of(FRAMES))


def reading(row: np.ndarray) -> ReadingAt:
    return ReadingAt(np.array([0.0, 0.0, 0.1, row[0]]), row[1:], np.zeros(4), np.zeros(3))


def test_expected_errors_are_the_models_given_all_readings_before() -> None:
    memory = CableMemory.of(CALIBRATED)
    assert memory is not None
    rows = np.cumsum(np.random.default_rng(0).normal(0, 0.1, (30, 4)), axis=0)
    expected = memory.model.errors(rows, play_of(rows, memory.model.width))
    np.testing.assert_allclose([memory.expected(reading(row)) for row in rows], expected)


def test_memory_goes_on_from_its_saved_state() -> None:
    first, second = CableMemory.of(CALIBRATED), CableMemory.of(CALIBRATED)
    assert first is not None
    assert second is not None
    rows = np.cumsum(np.random.default_rng(1).normal(0, 0.2, (20, 4)), axis=0)
    for row in rows[:10]:
        first.expected(reading(row))
    second.restore(json.loads(json.dumps(first.checkpoint())))
    for row in rows[10:]:
        np.testing.assert_array_equal(second.expected(reading(row)), first.expected(reading(row)))


def test_a_calibration_that_does_not_tell_of_cables_expects_nothing() -> None:
    assert CableMemory.of(replace(CALIBRATED, cables=None)) is None
    assert CableMemory.of(None) is None
