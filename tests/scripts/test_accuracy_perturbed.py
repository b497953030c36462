"""Moved poses on images without masks: sizes of the motions, and figures of a session."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.results.result import Result

JOINTS = {"wrist_pitch": 0.1, "wrist_yaw": -0.2, "jaw": 0.6}
POSE = np.array([[1.0, 0, 0, 0.01], [0, 1, 0, 0.02], [0, 0, 1, 0.1], [0, 0, 0, 1]])


def first_frames(folder: Path, count: int) -> Path:
    """Write the first of the bundled frames as a session."""
    demo = bundled_path("demo")
    header, *rows = (demo / "joints.csv").read_text(encoding="utf-8").splitlines()
    for part, suffix in (("masks", "png"), ("images", "jpg")):
        (folder / part).mkdir(parents=True)
        for row in rows[:count]:
            shutil.copy(demo / part / f"{row.split(',')[0]}.{suffix}", folder / part)
    shutil.copy(demo / "camera.yaml", folder)
    (folder / "joints.csv").write_text("\n".join([header, *rows[:count]]) + "\n", encoding="utf-8")
    return folder


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
def test_figures_of_a_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from measure.accuracy import perturbed
    from measure.cases import Measurement

    monkeypatch.setattr(perturbed, "TRIALS", 1)
    session = first_frames(tmp_path / "three", 3)
    (followed,), (fitted,) = perturbed.perturbed_report(Measurement([str(session)], frames=2)).values()
    for row in (followed, fitted):
        assert (row["images"], row["trials"]) == (2, 2)
        assert row["back"] <= row["back across the view"]
        assert row["back across the view"] in (0.0, 0.5, 1.0)
        assert 0 <= row["across the view, mm"] <= row["root, mm"] < 10
    assert fitted["back across the view"] > 0
