"""Estimation of a frame of a calibrated session: the prediction is refined; where that fails, the frame is searched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG
from helpers.page_calibrations import cables_of
from helpers.session_worlds import Truth, make_frames_in_memory, tip_mm, true_calibration
from helpers.transforms import moved

from dvrk_cmaes import Body, FrameData, Result, SessionCalibration, SessionFrame, estimate


class Known:
    """A session whose calibration is known, and a frame of it."""

    def __init__(self, body: Body) -> None:
        self.body = body
        base, self.truths, self.frames = make_frames_in_memory(body, 4, level="clean")
        self.session: SessionCalibration = true_calibration(body, base, self.truths, self.frames)

    @property
    def frame(self) -> SessionFrame:
        return self.frames[1]

    @property
    def truth(self) -> Truth:
        return self.truths[1]

    def estimate(self, session: SessionCalibration | None, readings: dict[str, float] | None = None) -> Result:
        data = self.frame.data
        assert isinstance(data, FrameData)
        given = self.frame.result.readings if readings is None else readings
        return estimate(data.mask, data.camera, given, self.body, session=session, config=QUICK_CONFIG)

    def tip_mm(self, result: Result) -> float:
        return tip_mm(result, self.truth)


@pytest.fixture(scope="module")
def known(bundled_body: Body) -> Known:
    return Known(bundled_body)


@pytest.mark.parametrize(("joint", "off"), [("insertion", 0.005), ("roll", 0.4), ("wrist_yaw", 0.4), ("jaw", 0.4)])
def test_readings_are_corrected_by_the_offsets(known: Known, joint: str, off: float) -> None:
    offsets, readings = {**known.session.offsets}, {**known.frame.result.readings}
    offsets[joint] += off
    readings[joint] -= off
    found = known.estimate(replace(known.session, offsets=offsets), readings)
    assert found.source == "session"
    assert known.tip_mm(found) < 0.5


@pytest.mark.parametrize("joint", ["roll", "wrist_pitch"])
def test_readings_are_corrected_by_what_cables_add_to_them(known: Known, joint: str) -> None:
    """The wrist's yaw drags another joint by as much as itself."""
    cables, names = cables_of(), ("roll", *known.body.instrument.joint_names)
    coupling = np.zeros((4, 4))
    coupling[names.index(joint), names.index("wrist_yaw")] = 1.0
    alone = replace(
        cables.alone,
        offset=tuple(known.session.offsets[name] for name in names),
        coupling=tuple(map(tuple, coupling.tolist())),
    )
    readings = {**known.frame.result.readings}
    assert abs(readings["wrist_yaw"]) > 0.15
    readings[joint] -= readings["wrist_yaw"]
    found = known.estimate(replace(known.session, cables=replace(cables, alone=alone)), readings)
    assert found.source == "session"
    assert known.tip_mm(found) < 0.5


@pytest.mark.parametrize(
    "change", [[0.005, 0.005, 0, 0.1, 0.1, 0.5], [0.02, 0.02, 0, 0.3, 0.3, 0.5]], ids=["beside", "out of view"]
)
def test_unexplained_frame_is_searched_with_warning(known: Known, change: list[float]) -> None:
    away = replace(known.session, camera_from_base=moved(known.session.camera_from_base, change))
    found, alone = known.estimate(away), known.estimate(None)
    assert found.source == "frame"
    (said,) = set(found.warnings) - set(alone.warnings)
    assert said.startswith("session: ")
    assert said.endswith(": searched anew")
    assert found.camera_from_root is not None
    np.testing.assert_array_equal(found.camera_from_root, alone.camera_from_root)


def test_mask_explained_far_from_prediction_is_searched(known: Known) -> None:
    # an error of the reading that the outline contradicts: the outer joints are never off by 8 deg
    readings = {**known.frame.result.readings}
    readings["yaw"] += np.deg2rad(8)
    found = known.estimate(known.session, readings)
    assert found.source == "frame"
    assert any(w.startswith("session: ") and w.endswith("searched anew") for w in found.warnings)


@pytest.mark.parametrize("missing", [("roll",), ("yaw", "pitch", "insertion", "roll")])
def test_frame_without_outer_readings_is_searched_with_warning(known: Known, missing: tuple[str, ...]) -> None:
    readings = {name: value for name, value in known.frame.result.readings.items() if name not in missing}
    found = known.estimate(known.session, readings)
    assert found.source == "frame"
    assert f"session: no reading of {', '.join(missing)}: searched without it" in found.warnings
