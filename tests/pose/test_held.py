"""A needle or thread in the jaws counts neither way; anything thicker is no such thing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import Body, FrameData, estimate
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.pose.held import HELD


@pytest.mark.parametrize(("share", "held"), [(0.1, True), (0.6, False)])
def test_thin_thing_in_the_jaws_does_not_count(bundled_body: Body, share: float, held: bool) -> None:
    """A line through the jaws, as wide as some share of the shaft."""
    instrument, ok, hidden = bundled_body.instrument, 0, 0
    _, truths, frames = make_frames_in_memory(bundled_body, 4, level="clean", seed=11)
    for truth, frame in zip(truths, frames, strict=True):
        assert isinstance(frame.data, FrameData)
        at, ends = Posed(truth.camera_from_root, truth.values), truth.tips
        tips, root = SMALL.project(ends), SMALL.project(truth.camera_from_root[None, :3, 3])[0]
        width = 2 * (instrument.shaft_radius or 0.0) * SMALL.fx / float(at.pose[2, 3])
        along = (tips.mean(axis=0) - root)[::-1] * [-1.2, 1.2]
        along *= width / np.linalg.norm(along)
        middle = 0.4 * root + 0.6 * tips.mean(axis=0)
        mask = frame.data.mask.astype(np.uint8)
        pixels = [[int(v) for v in middle + sign * along] for sign in (1, -1)]
        cv2.line(mask, *pixels, 1, max(1, round(share * width)))
        stored = StoredFrame.of(FrameData.of(mask > 0, SMALL), at, bundled_body, EstimateConfig())
        hidden += stored.views[0].counts is not None
        found = estimate(mask > 0, SMALL, frame.result.readings, instrument=bundled_body)
        assert (HELD in found.warnings) == (held and found.status == "ok")
        if found.status == "ok":
            assert found.camera_from_root is not None
            off = apply(found.camera_from_root, instrument.ends([*found.joints.values()])) - ends
            assert 1e3 * np.linalg.norm(off, axis=1).max() < 1.5
            ok += 1
    assert (hidden >= 3 and ok >= 2) if held else not (hidden or ok)


def test_right_mask_holds_nothing(bundled_body: Body) -> None:
    for truth, frame in zip(*make_frames_in_memory(bundled_body, 4, level="easy", seed=3)[1:], strict=True):
        assert isinstance(frame.data, FrameData)
        at = Posed(truth.camera_from_root, truth.values)
        assert StoredFrame.of(frame.data, at, bundled_body, EstimateConfig()).views[0].counts is None
