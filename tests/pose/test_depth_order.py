"""Which of two tools is in front: as their depths say, unless these are uncertain or the tools interlocked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.crossing_tools import APART, FAR, NEAR, CrossingTools

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.frames.seen_view import SeenView
from dvrk_cmaes.geometry import transform
from dvrk_cmaes.pose.depth_order import OPPOSITE, place_of_other
from dvrk_cmaes.results.result import Place, Result
from dvrk_cmaes.silhouette import Body


@pytest.fixture(scope="module")
def crossing(bundled_body: Body) -> CrossingTools:
    return CrossingTools(bundled_body)


def seen(camera: Camera, place: np.ndarray, masks: tuple[np.ndarray, np.ndarray]) -> list[SeenView]:
    """Give a view at a place with the mask of each of two tools."""
    return [SeenView("view", camera, place, mask) for mask in masks]


def place(tools: CrossingTools, results: tuple[Result, Result] | None = None, *more: list[SeenView]) -> Place:
    """Give where the second tool is, as seen by the first."""
    first, second = zip(seen(tools.camera, np.eye(4), tools.masks), *more, strict=True)
    found = (tools.result(0), tools.result(1)) if results is None else results
    return place_of_other(found, (tools.body, tools.body), (first, second))


def swapped(tools: CrossingTools) -> CrossingTools:
    return replace(tools, poses=tools.poses[::-1], joints=tools.joints[::-1])


def test_depths_along_rays_are_those_of_the_image(crossing: CrossingTools) -> None:
    rows, columns = np.mgrid[0:240:3, 0:320:3].reshape(2, -1)
    directions = np.c_[crossing.camera.normalise(np.c_[columns, rows].astype(float)), np.ones(len(rows))]
    links = crossing.body.camera_from_links(NEAR[None], crossing.joints[0][None])[0]
    depth, owner = crossing.body.scenes.depths(links, directions)
    expected = crossing.depths[0][rows, columns]
    same = np.isfinite(depth) == np.isfinite(expected)
    assert same.mean() > 0.999  # rays that graze an edge may differ
    hit = np.isfinite(depth) & np.isfinite(expected)
    assert hit.sum() > 500
    assert np.abs(depth[hit] - expected[hit]).max() < 1e-5
    assert ((owner >= 0) == np.isfinite(depth)).all()


def test_nearer_tool_is_in_front(crossing: CrossingTools) -> None:
    assert (np.isfinite(crossing.depths[0]) & np.isfinite(crossing.depths[1])).sum() > 300
    assert place(crossing) == "behind"
    assert place(swapped(crossing)) == "in front" == OPPOSITE["behind"]


def test_nearer_tool_is_in_front_at_any_place_before_the_other(bundled_body: Body) -> None:
    """What is found agrees with the true depths wherever something is found."""
    found: list[Place] = []
    for distance in np.linspace(0.09, 0.14, 11):
        near = NEAR.copy()
        near[2, 3] = distance
        tools = CrossingTools(bundled_body, (near, FAR))
        both = np.isfinite(tools.depths[0]) & np.isfinite(tools.depths[1])
        closer = (tools.depths[0] < tools.depths[1])[both].mean()
        found.append(place(tools))
        if found[-1] == "behind":
            assert closer > 0.94
        if found[-1] == "in front":
            assert closer < 0.06
        if 0.2 < closer < 0.8:  # interlocked
            assert found[-1] == "unclear"
    assert {"behind", "in front", "unclear"} == set(found)


@pytest.mark.parametrize(
    "doubt", [{"std_m": 0.02}, {"std_rad": 0.5}, {"probability": 0.7}], ids=["distance", "tilt", "mode"]
)
@pytest.mark.parametrize("tool", [0, 1])
def test_uncertain_poses_do_not_tell_it(crossing: CrossingTools, tool: int, doubt: dict[str, Any]) -> None:
    results = [crossing.result(0), crossing.result(1)]
    results[tool] = crossing.result(tool, **doubt)
    assert place(crossing, (results[0], results[1])) == "unclear"


def test_pose_of_a_session_has_no_probability_and_tells_it(crossing: CrossingTools) -> None:
    by_session = replace(crossing.result(0), mode_probability=None)
    assert place(crossing, (by_session, crossing.result(1))) == "behind"


def test_result_without_a_pose_tells_nothing(crossing: CrossingTools) -> None:
    failed = replace(crossing.result(1), camera_from_root=None)
    assert place(crossing, (crossing.result(0), failed)) == "unclear"


def test_tools_that_do_not_meet_are_apart(bundled_body: Body) -> None:
    assert place(CrossingTools(bundled_body, APART)) == "apart"


def test_a_view_in_which_they_do_not_meet_says_nothing(crossing: CrossingTools) -> None:
    empty = np.zeros_like(crossing.masks[0])
    aside = seen(crossing.camera, transform(np.eye(3), [10.0, 0.0, 0.0]), (empty, empty))
    assert place(crossing, None, aside) == "behind"


def test_views_that_contradict_each_other_do_not_tell_it(crossing: CrossingTools) -> None:
    """Seen from the opposite side, the farther tool is in front."""
    turned = transform(np.diag([-1.0, 1.0, -1.0]), [0.0, 0.0, 0.24])
    behind = replace(crossing, poses=tuple(turned @ pose for pose in crossing.poses))
    other_side = seen(crossing.camera, turned, behind.masks)
    assert place(crossing, None, other_side) == "unclear"
