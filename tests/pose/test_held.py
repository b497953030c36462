"""A needle or thread in the jaws counts neither way; anything thicker is no such thing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import Body, FrameData, estimate

pytestmark = pytest.mark.usefixtures("searches_short")

HELD = "something thin is held in the jaws: its pixels do not count"


@pytest.mark.parametrize(("share", "held"), [(0.1, True), (0.6, False)])
def test_thin_thing_in_the_jaws_does_not_count(bundled_body: Body, share: float, held: bool) -> None:
    """A line through the jaws, as wide as some share of the shaft."""
    instrument, ok = bundled_body.instrument, 0
    _, truths, frames = make_frames_in_memory(bundled_body, 4, level="clean", seed=11)
    for truth, frame in zip(truths, frames, strict=True):
        assert isinstance(frame.data, FrameData)
        tips, root = SMALL.project(truth.tips), SMALL.project(truth.camera_from_root[None, :3, 3])[0]
        width = 2 * (instrument.shaft_radius or 0.0) * SMALL.fx / float(truth.camera_from_root[2, 3])
        along = (tips.mean(axis=0) - root)[::-1] * [-1.2, 1.2]
        along *= width / np.linalg.norm(along)
        middle = 0.4 * root + 0.6 * tips.mean(axis=0)
        mask = frame.data.mask.astype(np.uint8)
        pixels = [[int(v) for v in middle + sign * along] for sign in (1, -1)]
        cv2.line(mask, *pixels, 1, max(1, round(share * width)))
        found = estimate(mask > 0, SMALL, frame.result.readings, instrument=bundled_body)
        assert (HELD in found.warnings) == (held and found.status == "ok")
        if found.status == "ok":
            assert 1e3 * np.linalg.norm(np.array(found.tips) - truth.tips, axis=1).max() < 1.5
            ok += 1
    assert ok >= 2 if held else not ok


def test_right_mask_holds_nothing(bundled_body: Body) -> None:
    for frame in make_frames_in_memory(bundled_body, 4, level="easy", seed=3)[2]:
        assert isinstance(frame.data, FrameData)
        assert HELD not in estimate(frame.data.mask, SMALL, frame.result.readings, instrument=bundled_body).warnings
