"""A needle or thread in the jaws counts neither way; anything thicker is no such thing."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.session_worlds import SMALL, Truth, make_frames_in_memory

from dvrk_cmaes import Body, FrameData, SessionFrame, calibrate_session, estimate
from dvrk_cmaes.geometry import Bool

pytestmark = pytest.mark.usefixtures("searches_short")

HELD = "something thin is held in the jaws: its pixels do not count"


def with_a_line(body: Body, truth: Truth, frame: SessionFrame, share: float) -> Bool:
    """Return the mask of a frame with a line through the jaws, as wide as some share of the shaft."""
    tips, root = SMALL.project(truth.tips), SMALL.project(truth.camera_from_root[None, :3, 3])[0]
    width = 2 * (body.instrument.shaft_radius or 0.0) * SMALL.fx / float(truth.camera_from_root[2, 3])
    along = (tips.mean(axis=0) - root)[::-1] * [-1.2, 1.2]
    along *= width / np.linalg.norm(along)
    middle = 0.4 * root + 0.6 * tips.mean(axis=0)
    assert isinstance(frame.data, FrameData)
    mask = frame.data.mask.astype(np.uint8)
    start, end = ([int(v) for v in middle + sign * along] for sign in (1, -1))
    cv2.line(mask, start, end, 1, max(1, round(share * width)))
    return np.asarray(mask > 0)


@pytest.mark.parametrize(("share", "held"), [(0.1, True), (0.6, False)])
def test_thin_thing_in_the_jaws_does_not_count(bundled_body: Body, share: float, held: bool) -> None:
    ok = 0
    _, truths, frames = make_frames_in_memory(bundled_body, 4, level="clean", seed=11)
    for truth, frame in zip(truths, frames, strict=True):
        mask = with_a_line(bundled_body, truth, frame, share)
        found = estimate(mask, SMALL, frame.result.readings, instrument=bundled_body)
        assert (HELD in found.warnings) == (held and found.status == "ok")
        if found.status == "ok":
            assert 1e3 * np.linalg.norm(np.array(found.tips) - truth.tips, axis=1).max() < 1.5
            ok += 1
    assert ok >= 2 if held else not ok


@pytest.mark.parametrize("hidden", [False, True])
def test_thin_thing_does_not_count_in_a_session(bundled_body: Body, hidden: bool) -> None:
    """With and without pixels that are to be ignored for another reason."""
    _, truths, frames = make_frames_in_memory(bundled_body, 6, level="clean", seed=11)
    ignore = np.zeros((SMALL.height, SMALL.width), dtype=bool)
    ignore[:5, :5] = hidden
    held = list[SessionFrame]()
    for truth, frame in zip(truths, frames, strict=True):
        mask = with_a_line(bundled_body, truth, frame, 0.1)
        alone = estimate(mask, SMALL, frame.result.readings, ignore=ignore, instrument=bundled_body)
        held.append(SessionFrame(frame.name, FrameData.of(mask, SMALL, ignore), replace(alone, frame=frame.name)))
    results = calibrate_session(held, bundled_body).results.values()
    assert sum(HELD in result.warnings for result in results) >= 5
    assert sum(result.status == "ok" for result in results) >= 5


def test_right_mask_holds_nothing(bundled_body: Body) -> None:
    for frame in make_frames_in_memory(bundled_body, 4, level="easy", seed=3)[2]:
        assert isinstance(frame.data, FrameData)
        assert HELD not in estimate(frame.data.mask, SMALL, frame.result.readings, instrument=bundled_body).warnings
