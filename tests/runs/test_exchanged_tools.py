"""Tools whose masks or readings were exchanged."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.page_results import result

from dvrk_cmaes import Result
from dvrk_cmaes.runs.agreement import exchanged_arms, exchanged_masks, exchanged_tools

NAMES = ("wrist_pitch", "wrist_yaw", "jaw")


def results(joints: np.ndarray, readings: np.ndarray, *, bad: range = range(0)) -> dict[str, Result]:
    """Give the results of frames with given joints and readings (N, 3), rad, some of which are not ok."""
    return {
        f"{k:04d}": result(
            f"{k:04d}",
            joints=dict(zip(NAMES, found.tolist(), strict=True)),
            readings=dict(zip(NAMES, read.tolist(), strict=True)),
            status="doubtful" if k in bad else "ok",
        )
        for k, (found, read) in enumerate(zip(joints, readings, strict=True))
    }


def test_exchange_is_found_by_the_readings_of_the_other_tool() -> None:
    rng = np.random.default_rng(0)
    true = rng.uniform(-0.8, 0.8, (2, 6, 3))
    read = true + np.deg2rad(8) * rng.standard_normal(true.shape)
    right = {"PSM1": results(true[0], read[0]), "PSM2": results(true[1], read[1])}
    assert exchanged_tools(right) == []
    (text,) = exchanged_tools({"PSM1": results(true[0], read[1]), "PSM2": results(true[1], read[0])})
    assert text.startswith("PSM1 and PSM2: the joints found for each are nearer to the readings of the other")


def test_two_frames_tell_nothing() -> None:
    rng = np.random.default_rng(1)
    true = rng.uniform(-0.8, 0.8, (2, 2, 3))
    assert exchanged_tools({"PSM1": results(true[0], true[1]), "PSM2": results(true[1], true[0])}) == []


@pytest.mark.parametrize("start", [0, 25])
def test_exchange_while_followed_is_found_with_its_first_frame(start: int) -> None:
    rng = np.random.default_rng(2)
    true = np.cumsum(0.03 * rng.standard_normal((2, 60, 3)), axis=1) + np.array([0.5, -0.5])[:, None, None]
    read = true + np.deg2rad(8) * rng.standard_normal((2, 1, 3))
    assert exchanged_tools({"PSM1": results(true[0], read[0]), "PSM2": results(true[1], read[1])}, followed=True) == []
    seen = true.copy()
    seen[:, start:] = true[::-1, start:]
    (text,) = exchanged_tools({"PSM1": results(seen[0], read[0]), "PSM2": results(seen[1], read[1])}, followed=True)
    assert text.startswith("PSM1 and PSM2: the joints found for each are nearer to the readings of the other")
    assert text.endswith(f"from frame {start:04d} on")


def test_tools_of_the_same_joints_are_not_taken_for_exchanged() -> None:
    rng = np.random.default_rng(3)
    true = np.cumsum(0.03 * rng.standard_normal((60, 3)), axis=0)
    read = true + np.deg2rad(8) * rng.standard_normal((2, 1, 3))
    assert exchanged_tools({"PSM1": results(true, read[0]), "PSM2": results(true, read[1])}, followed=True) == []


def test_masks_may_be_exchanged_where_neither_tool_is_ok() -> None:
    still = np.tile([0.1, -0.2, 0.5], (20, 1))
    first, both = results(still, still, bad=range(5, 12)), results(still, still, bad=range(6, 12))
    (text,) = exchanged_arms({"PSM1": first, "PSM2": both})
    assert text == (
        "PSM1 and PSM2: neither is ok in 6 of 20 frames (0006, 0007, 0008, 0009, 0010, ...); "
        "their masks may be exchanged there"
    )
    assert exchanged_masks({"PSM1": first, "PSM2": results(still, still, bad=range(10, 18))}) == []
    assert exchanged_masks({"PSM1": first, "PSM2": results(still, still)}) == []
