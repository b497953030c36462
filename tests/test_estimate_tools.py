"""`estimate_tools`: tools that hide each other, in one view and in two."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG
from helpers.crossing_tools import APART, ARMS, CAMERA, CrossingTools

from dvrk_cmaes import Body, EstimateConfig, InputError, Result, ToolInFrame, estimate, estimate_tools
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.frame import with_tool

QUICK = EstimateConfig()
QUICK = replace(QUICK, threads=1, search=replace(QUICK.search, samples=128, starts=3, evaluations=200))


def readings(tools: CrossingTools, number: int) -> dict[str, float]:
    return {name: value + 0.06 for name, value in tools.values(number).items()}


def of_one_view(tools: CrossingTools) -> dict[str, ToolInFrame]:
    return {arm: ToolInFrame(tools.masks[k], readings(tools, k), tools.body) for k, arm in enumerate(ARMS)}


def alone(tools: CrossingTools, number: int, config: EstimateConfig = QUICK, **more: Any) -> Result:
    """Estimate one of the tools by itself."""
    return estimate(tools.masks[number], CAMERA, readings(tools, number), tools.body, config=config, **more)


def tip_mm(tools: CrossingTools, number: int, result: Result) -> float:
    assert result.camera_from_root is not None
    truth = tools.poses[number], tools.values(number)
    error = compare_poses(tools.body.instrument, (result.camera_from_root, result.joints), truth).tip_mm
    assert error is not None
    return error


@pytest.fixture(scope="module")
def crossing(bundled_body: Body) -> CrossingTools:
    return CrossingTools(bundled_body)


@pytest.fixture(scope="module")
def together(crossing: CrossingTools) -> dict[str, Result]:
    return estimate_tools(of_one_view(crossing), CAMERA, config=QUICK, frame="0007", time=1.5)


def test_tools_that_cross_are_estimated_without_the_pixels_of_each_other(
    crossing: CrossingTools, together: dict[str, Result]
) -> None:
    for number, (arm, found) in enumerate(together.items()):
        by_itself = alone(crossing, number, ignore=with_tool(None, crossing.masks[1 - number]))
        np.testing.assert_array_equal(found.camera_from_root, by_itself.camera_from_root)
        assert (arm, found.frame, found.time, found.joints) == (ARMS[number], "0007", 1.5, by_itself.joints)
        assert tip_mm(crossing, number, found) < 1.5


def test_tools_that_do_not_meet_are_estimated_by_themselves(bundled_body: Body) -> None:
    tools = CrossingTools(bundled_body, APART)
    found = estimate_tools(of_one_view(tools), CAMERA, config=QUICK_CONFIG)
    for number, arm in enumerate(ARMS):
        by_itself = alone(tools, number, QUICK_CONFIG, ignore=with_tool(None, tools.masks[1 - number]))
        np.testing.assert_array_equal(found[arm].camera_from_root, by_itself.camera_from_root)


def test_one_tool_is_estimated_as_by_estimate(crossing: CrossingTools) -> None:
    ignore = with_tool(None, crossing.masks[1])
    one = estimate_tools({"PSM1": of_one_view(crossing)["PSM1"]}, CAMERA, ignore=ignore, config=QUICK_CONFIG)["PSM1"]
    by_itself = alone(crossing, 0, QUICK_CONFIG, ignore=ignore)
    assert one.to_dict() | {"seconds": 0} == by_itself.to_dict() | {"seconds": 0}


def test_start_gives_the_optimum_of_a_search(crossing: CrossingTools) -> None:
    searched = alone(crossing, 0)
    again = alone(crossing, 0, start=searched)
    assert again.evaluations < searched.evaluations
    assert np.abs(np.subtract(again.tips, searched.tips)).max() < 1e-4


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        (np.ones((10, 10), np.bool_), r"PSM2: mask: expected 320 x 240 pixels as the camera has, got .* \(10, 10\)"),
        (np.zeros((240, 320), np.bool_), "PSM2: mask: expected some instrument"),
    ],
)
def test_wrong_mask_is_named(crossing: CrossingTools, mask: np.ndarray, message: str) -> None:
    tools = of_one_view(crossing)
    with pytest.raises(InputError, match=f"^{message}"):
        estimate_tools(tools | {"PSM2": replace(tools["PSM2"], mask=mask)}, CAMERA, config=QUICK)
