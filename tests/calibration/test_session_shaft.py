"""The sizes of the instrument against its file's: their effect, what a session finds, and when that is a doubt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import make_frames_in_memory

from dvrk_cmaes import Body, EstimateConfig, FrameData, calibrate_session
from dvrk_cmaes.calibration.constants import OutlineOfView
from dvrk_cmaes.calibration.session_shaft import InstrumentSizes, SessionShaft
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.instrument.kinematics import Chain
from dvrk_cmaes.instrument.model import Link
from dvrk_cmaes.pose.terms.sized_view import SizedView


def with_shaft(body: Body, scale: float) -> Body:
    """Give the instrument whose shaft is thicker by a factor; its other links stay as they are."""
    instrument = body.instrument
    assert instrument.shaft is not None
    shaft, first = instrument.shaft, instrument.links[0]
    from_axis = first.vertices - shaft.point
    along = (from_axis @ shaft.direction)[:, None] * shaft.direction
    links = (replace(first, vertices=shaft.point + along + scale * (from_axis - along)), *instrument.links[1:])
    return Body.prepare(replace(instrument, links=links, shaft=replace(shaft, radius=scale * shaft.radius)))


def longer(link: Link, end: Float64, scale: float) -> Link:
    """Give a link of which what is between its origin and an end (3,) is longer by a factor."""
    share = np.clip(link.vertices @ end / (end @ end), 0.0, 1.0)
    return replace(link, vertices=link.vertices + (scale - 1) * share[:, None] * end)


def with_wrist(body: Body, scale: float) -> Body:
    """Give the instrument whose jaws' axis is farther from the wrist's by a factor."""
    instrument = body.instrument
    first, last = instrument.hinges
    end = instrument.chain.joints[last].parent_from_joint[:3, 3]
    farther = np.eye(4)
    farther[:3, 3] = (scale - 1) * end
    joints = [
        replace(one, parent_from_joint=farther @ one.parent_from_joint) if one.parent == first else one
        for one in instrument.chain.joints
    ]
    links = [
        longer(link, end, scale) if joint == first else link
        for link, joint in zip(instrument.links, instrument.link_joints, strict=True)
    ]
    return Body.prepare(replace(instrument, links=tuple(links), chain=Chain(tuple(joints))))


def with_jaws(body: Body, scale: float) -> Body:
    """Give the instrument whose jaws are longer by a factor."""
    links = list(body.instrument.links)
    for tip in body.instrument.jaw_tips:
        links[tip.link] = longer(links[tip.link], tip.position, scale)
    return Body.prepare(replace(body.instrument, links=tuple(links)))


@pytest.mark.parametrize(("number", "resized"), [(0, with_shaft), (1, with_wrist), (2, with_jaws)])
def test_effect_is_the_area_that_a_larger_part_adds(
    bundled_body: Body, number: int, resized: Callable[[Body, float], Body]
) -> None:
    _, truths, frames = make_frames_in_memory(bundled_body, 3, level="clean", seed=11)
    assert isinstance(frames[0].data, FrameData)
    at, areas = Posed(truths[0].camera_from_root, truths[0].values), []
    stored = StoredFrame.of(frames[0].data, at, bundled_body, EstimateConfig())
    for scale in (1 / 1.03, 1.03):
        view = SizedView(stored.views[0].restored(resized(bundled_body, scale)), blur=1.2)
        (drawn,) = view.draw(Posed.stacked([at]), 2, [0.5], None)
        areas.append(float(drawn.coverage(view.camera.width).sum()))
    view = SizedView(stored.views[0].restored(bundled_body), blur=1.2)
    (points,) = view.outlines(Posed.stacked([at]))
    outline = OutlineOfView("", view, points, np.zeros((len(points.link), 9)), at, 1.0)
    effect = InstrumentSizes(bundled_body.instrument).effect(outline)[:, number]
    assert effect.sum() == pytest.approx((areas[1] - areas[0]) / (2 * np.log(1.03)), rel=0.15)


@pytest.mark.parametrize("scale", [1.0, 1.2, 0.8])
def test_another_radius_is_a_doubt_and_the_right_one_is_none(bundled_body: Body, scale: float) -> None:
    """Frames that are fitted with another shaft lie farther away in proportion to its radius."""
    _, _, frames = make_frames_in_memory(bundled_body, 10, level="clean")
    seen = []
    for frame in frames:
        assert frame.result.camera_from_root is not None
        pose = frame.result.camera_from_root.copy()
        pose[:3, 3] *= scale
        seen.append(replace(frame, result=replace(frame.result, camera_from_root=pose)))
    found = calibrate_session(seen, bundled_body if scale == 1 else with_shaft(bundled_body, scale)).calibration
    assert found.shaft is not None
    assert bool(found.doubts) == (scale != 1)
    if scale == 1:
        assert abs(found.shaft.radius_scale - 1) < 0.02
    else:
        assert (found.shaft.radius_scale - 1) * (1 - scale) > 0


def test_doubt_says_by_how_much() -> None:
    assert SessionShaft(1.04, 0.01, 1.09, 0.01, 0.91, 0.02).contradictions() == []
    assert SessionShaft(0.6, 0.2, 0.5, 0.2, 1.5, 0.2).contradictions() == []
    shaft, wrist, jaws = SessionShaft(0.63, 0.02, 1.15, 0.03, 2.0, 0.1).contradictions()
    assert "the shaft is 37 % (std 2) thinner than the instrument's" in shaft
    assert "the length from the wrist's to the jaws' axis is 15 % (std 3) longer" in wrist
    assert "the jaws are 100 % (std 10) longer" in jaws
