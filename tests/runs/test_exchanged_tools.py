"""Tools whose masks or readings were exchanged."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.exchanged_tools import FoundFrame, exchanged_tools, masks_exchanged

NAMES = ("wrist_pitch", "wrist_yaw", "jaw")


def results(joints: np.ndarray, readings: np.ndarray) -> dict[str, Result]:
    """Give the results of frames with given joints and readings (N, 3), rad."""
    return {
        f"{k:04d}": Result(
            f"{k:04d}",
            "ok",
            (),
            "lnd",
            "roll_link",
            np.eye(4),
            dict(zip(NAMES, found.tolist(), strict=True)),
            dict(zip(NAMES, read.tolist(), strict=True)),
        )
        for k, (found, read) in enumerate(zip(joints, readings, strict=True))
    }


def test_exchange_is_told_by_the_readings_of_the_other_tool() -> None:
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


def followed(joints: np.ndarray, readings: np.ndarray) -> dict[str, FoundFrame]:
    """Give the joints of followed frames as found and as read (N, 3), rad."""
    return {name: FoundFrame(one.joints, one.readings, ok=True) for name, one in results(joints, readings).items()}


@pytest.mark.parametrize("start", [0, 25])
def test_exchange_while_followed_is_told_with_its_first_frame(start: int) -> None:
    rng = np.random.default_rng(2)
    true = np.cumsum(0.03 * rng.standard_normal((2, 60, 3)), axis=1) + np.array([0.5, -0.5])[:, None, None]
    read = true + np.deg2rad(8) * rng.standard_normal((2, 1, 3))
    assert (
        exchanged_tools({"PSM1": followed(true[0], read[0]), "PSM2": followed(true[1], read[1])}, followed=True) == []
    )
    seen = true.copy()
    seen[:, start:] = true[::-1, start:]
    (text,) = exchanged_tools({"PSM1": followed(seen[0], read[0]), "PSM2": followed(seen[1], read[1])}, followed=True)
    assert text.startswith("PSM1 and PSM2: the joints found for each are nearer to the readings of the other")
    assert text.endswith(f"from frame {start:04d} on")


def test_tools_of_the_same_joints_are_not_taken_for_exchanged() -> None:
    rng = np.random.default_rng(3)
    true = np.cumsum(0.03 * rng.standard_normal((60, 3)), axis=0)
    read = true + np.deg2rad(8) * rng.standard_normal((2, 1, 3))
    assert exchanged_tools({"PSM1": followed(true, read[0]), "PSM2": followed(true, read[1])}, followed=True) == []


def test_masks_are_exchanged_if_those_of_the_other_tool_fit_better_in_most_frames() -> None:
    assert masks_exchanged([(0.37, 0.11), (0.22, 0.12), (0.13, 0.09)])
    assert not masks_exchanged([(0.11, 0.37), (0.12, 0.22), (0.09, 0.13)])
    assert not masks_exchanged([(0.37, 0.11), (0.22, 0.12)])  # too few frames
    assert not masks_exchanged([(0.10, 0.09), (0.10, 0.11), (0.10, 0.05), (0.10, 0.12)])  # no better in half of them
    assert not masks_exchanged([(0.10, 0.095)] * 5)  # hardly better, as with tools in the same pose
