"""The radius of the shaft against the instrument's: its effect, what a session finds, and when that is a doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import make_frames_in_memory

from dvrk_cmaes.calibration.calibrate import calibrate_session
from dvrk_cmaes.calibration.constants import OutlineOfView
from dvrk_cmaes.calibration.session_shaft import SessionShaft, ShaftRadius
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameData
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.sized_view import SizedView
from dvrk_cmaes.silhouette import Body


def with_shaft(body: Body, scale: float) -> Body:
    """Give the instrument whose shaft is thicker by a factor; its other links stay as they are."""
    instrument = body.instrument
    assert instrument.shaft is not None
    shaft, first = instrument.shaft, instrument.links[0]
    from_axis = first.vertices - shaft.point
    along = (from_axis @ shaft.direction)[:, None] * shaft.direction
    links = (replace(first, vertices=shaft.point + along + scale * (from_axis - along)), *instrument.links[1:])
    return Body.prepare(replace(instrument, links=links, shaft=replace(shaft, radius=scale * shaft.radius)))


def test_effect_is_the_area_that_a_thicker_shaft_adds(bundled_body: Body) -> None:
    _, truths, frames = make_frames_in_memory(bundled_body, 3, level="clean", seed=11)
    assert isinstance(frames[0].data, FrameData)
    at, areas = Posed(truths[0].camera_from_root, truths[0].values), []
    stored = StoredFrame.of(frames[0].data, at, bundled_body, EstimateConfig())
    for scale in (1 / 1.03, 1.03):
        view = SizedView(stored.views[0].restored(with_shaft(bundled_body, scale)), blur=1.2)
        (drawn,) = view.draw(Posed.stacked([at]), 2, [0.5], outlines=False)
        areas.append(float(drawn.coverage(view.camera.width).sum()))
    view = SizedView(stored.views[0].restored(bundled_body), blur=1.2)
    (points,) = view.outlines(Posed.stacked([at]))
    assert bundled_body.instrument.shaft is not None
    outline = OutlineOfView("", view, points, np.zeros((len(points.link), 9)), at, 1.0)
    effect = ShaftRadius(bundled_body.instrument.shaft.radius).effect(outline)
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
    assert SessionShaft(1.04, 0.01).contradiction() == ""
    assert SessionShaft(0.6, 0.2).contradiction() == ""
    assert "the shaft is 37 % (std 2) thinner than the instrument's" in SessionShaft(0.63, 0.02).contradiction()
