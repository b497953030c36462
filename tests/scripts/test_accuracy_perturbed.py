"""Moved poses on images without masks: sizes of the motions, and figures of a session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.results.result import Result

JOINTS = {"wrist_pitch": 0.1, "wrist_yaw": -0.2, "jaw": 0.6}
POSE = np.array([[1.0, 0, 0, 0.01], [0, 1, 0, 0.02], [0, 0, 1, 0.1], [0, 0, 0, 1]])


@pytest.mark.usefixtures("scripts_on_path")
def test_poses_are_moved_by_what_is_said() -> None:
    from measure.accuracy.perturbed import _moved

    failed = Result.failed("a", "b", {}, instrument="lnd", root_link="roll_link")
    found = _moved(replace(failed, camera_from_root=POSE, joints=JOINTS), np.random.default_rng(1))
    assert found.camera_from_root is not None
    assert np.linalg.norm(found.camera_from_root[:3, 3] - POSE[:3, 3]) == pytest.approx(3e-3)
    assert np.degrees(rotation_angle(found.camera_from_root, POSE)) == pytest.approx(5)
    assert [np.degrees(abs(found.joints[name] - value)) for name, value in JOINTS.items()] == pytest.approx([10] * 3)


@pytest.mark.usefixtures("scripts_on_path")
def test_figures_of_a_session(monkeypatch: pytest.MonkeyPatch) -> None:

    from measure.accuracy import perturbed
    from measure.cases import Measurement

    monkeypatch.setattr(perturbed, "TRIALS", 1)
    (followed,), (fitted,) = perturbed.perturbed_report(Measurement([str(bundled_path("demo"))], frames=2)).values()
    for row in (followed, fitted):
        assert (row["images"], row["trials"]) == (2, 2)
        assert row["back"] <= row["back across the view"]
        assert row["back across the view"] in (0.0, 0.5, 1.0)
        assert 0 <= row["across the view, mm"] <= row["root, mm"] < 10
    assert fitted["back across the view"] > 0
