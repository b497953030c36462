"""Masks found again around the silhouettes that a session expects: what is solved again, compared, and kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import (
    Body,
    EstimateConfig,
    FrameData,
    Renderer,
    SessionCalibration,
    SessionFrame,
    SolvedSession,
    calibrate_session,
)
from dvrk_cmaes.calibration.masks_again import MasksAgain
from dvrk_cmaes.config import SessionConfig

Bool = np.ndarray
Masks = Mapping[str, Bool]
Finder = Callable[[Masks, Masks], Masks]

QUICK = EstimateConfig(session=SessionConfig(rounds=2))
SPOILT = (2, 5)


def with_lobe(mask: Bool) -> Bool:
    """Return a mask with a disc added at its outline, as of a shadow taken for the instrument."""
    rows, columns = np.nonzero(mask & ~cv2.erode(mask.astype(np.uint8), np.ones((3, 3))).astype(bool))
    middle = len(rows) // 2
    drawn = mask.astype(np.uint8)
    cv2.circle(drawn, (int(columns[middle]), int(rows[middle])), 14, 1, -1)
    return np.asarray(drawn > 0)


def with_finder(frame: SessionFrame, find: Finder) -> SessionFrame:
    return replace(frame, find_masks=find)


@pytest.fixture(scope="module")
def spoilt(bundled_body: Body) -> tuple[list[SessionFrame], dict[str, Bool]]:
    """Eight frames, of which two have a lobe at their masks, and the right masks by frame."""
    frames = make_frames_in_memory(bundled_body, 8, level="clean")[2]
    right = {frame.name: frame.data.mask for frame in frames if isinstance(frame.data, FrameData)}
    for i in SPOILT:
        data = frames[i].data
        assert isinstance(data, FrameData)
        view = replace(data.views[0], mask=with_lobe(data.mask))
        frames[i] = replace(frames[i], data=replace(data, views=(view,)))
    return frames, right


def solved_with(body: Body, frames: list[SessionFrame], of: Callable[[SessionFrame], Finder]) -> SolvedSession:
    return calibrate_session([with_finder(frame, of(frame)) for frame in frames], body, config=QUICK)


@pytest.fixture(scope="module")
def corrected(bundled_body: Body, spoilt: tuple[list[SessionFrame], dict[str, Bool]]) -> SolvedSession:
    """The session whose masks, found again, are the right ones."""
    frames, right = spoilt
    return solved_with(bundled_body, frames, lambda frame: lambda seen, first: dict.fromkeys(seen, right[frame.name]))


def again_of(solved: SolvedSession) -> MasksAgain:
    again = solved.calibration.masks_again
    assert again is not None
    return again


def test_frames_are_solved_with_their_new_masks(
    bundled_body: Body, spoilt: tuple[list[SessionFrame], dict[str, Bool]], corrected: SolvedSession
) -> None:
    before = calibrate_session(spoilt[0], bundled_body, config=QUICK)
    for i in SPOILT:
        first, second = before.results[f"{i:04d}"].quality, corrected.results[f"{i:04d}"].quality
        assert first is not None
        assert second is not None
        assert second.iou > first.iou + 0.005
    name = f"{SPOILT[0]:04d}"
    np.testing.assert_array_equal(corrected.found_masks[name]["left"].restored(), spoilt[1][name])


def test_predictions_are_measured_against_the_first_masks(
    bundled_body: Body, spoilt: tuple[list[SessionFrame], dict[str, Bool]], corrected: SolvedSession
) -> None:
    again, pairs = again_of(corrected), list(corrected.calibration.leave_one_out.values())
    assert again.iou_after == pytest.approx(np.mean([iou for iou, _ in pairs]), abs=1e-6)
    assert again.contour_px_after == pytest.approx(np.median([px for _, px in pairs]), abs=1e-6)
    for name in corrected.found_masks:
        predicted = corrected.leave_one_out[name]
        drawn = Renderer(bundled_body, SMALL).masks(predicted.camera_from_root[None], predicted.joints[None])[0]
        against_new = (drawn & spoilt[1][name]).sum() / (drawn | spoilt[1][name]).sum()
        assert predicted.iou < against_new - 0.005


def test_masks_by_which_the_first_ones_are_predicted_worse_are_not_used(
    bundled_body: Body, spoilt: tuple[list[SessionFrame], dict[str, Bool]]
) -> None:
    frames, right = spoilt

    def finder(frame: SessionFrame) -> Finder:
        shifted = np.roll(right[frame.name], 6, axis=1)
        return lambda seen, first: dict.fromkeys(seen, shifted)

    wrong = solved_with(bundled_body, frames, finder)
    again, kept = again_of(wrong), calibrate_session(frames, bundled_body, config=QUICK)
    assert not again.applied
    assert again.iou_after < again.iou_before
    assert again.describe().endswith("not used, since the first masks are predicted worse")
    assert wrong.found_masks == {}
    np.testing.assert_array_equal(wrong.calibration.camera_from_base, kept.calibration.camera_from_base)
    assert wrong.calibration.leave_one_out == kept.calibration.leave_one_out


def test_the_document_has_what_changed(corrected: SolvedSession) -> None:
    document = corrected.calibration.to_dict()
    assert document["masks_again"]["changed"] == len(SPOILT)
    assert SessionCalibration.from_dict(document).to_dict()["masks_again"] == document["masks_again"]
