"""The sizes of the instrument against its file's: their effect, what a session finds, and when that is a doubt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.resized import with_shaft, with_size
from helpers.session_worlds import SMALL, make_frames_in_memory

from dvrk_cmaes import Body, FrameData, Renderer, calibrate_session


@pytest.mark.parametrize("scale", [1.2, 0.8])
def test_another_radius_is_a_doubt(bundled_body: Body, scale: float) -> None:
    """Frames that are fitted with another shaft lie farther away in proportion to its radius."""
    _, _, frames = make_frames_in_memory(bundled_body, 8, level="clean")
    seen = []
    for frame in frames:
        assert frame.result.camera_from_root is not None
        pose = frame.result.camera_from_root.copy()
        pose[:3, 3] *= scale
        seen.append(replace(frame, result=replace(frame.result, camera_from_root=pose)))
    found = calibrate_session(seen, with_shaft(bundled_body, scale)).calibration
    assert found.doubts
    assert found.blocks["parts"].values[found.blocks["parts"].axes.index("radius")] * (1 - scale) > 0


def test_whole_instrument_that_is_larger_is_found_and_is_a_doubt(bundled_body: Body) -> None:
    """Outlines that are linearised at the model's size alone show a fraction of it, as those far off are outliers."""
    _, truths, frames = make_frames_in_memory(bundled_body, 8, level="clean")
    renderer, seen = Renderer(with_size(bundled_body, 1.05), SMALL), []
    for frame, truth in zip(frames, truths, strict=True):
        (mask,) = renderer.masks(truth.camera_from_root[None], truth.values[None])
        assert frame.result.camera_from_root is not None
        pose = frame.result.camera_from_root.copy()
        pose[:3, 3] /= 1.05
        result = replace(frame.result, camera_from_root=pose)
        seen.append(replace(frame, data=FrameData.of(mask, SMALL), result=result))
    found = calibrate_session(seen, bundled_body).calibration
    assert found.blocks["lens"].std[0] < 0.95 * found.blocks["lens"].prior_std[0]  # frames determine the aspect
    (whole,), (std,) = found.blocks["size"].values, found.blocks["size"].std
    assert abs(np.exp(whole) - 1.05) < 3 * std < 0.05
    percent = round(100 * np.expm1(whole))
    assert any(f"all of it is {percent} % (std" in doubt and "larger" in doubt for doubt in found.doubts)
