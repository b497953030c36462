"""scripts/accuracy.py rig: a frame as each eye sees it, both, and both with a wrong rig."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import Ran
from helpers.places import ROOT
from helpers.stereo_sessions import make_stereo_session

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import rotation_angle
from dvrk_cmaes.silhouette import Body


@pytest.mark.usefixtures("scripts_on_path")
def test_eyes_have_their_own_masks_and_a_wrong_rig_is_off_by_what_is_said(bundled_body: Body, tmp_path: Path) -> None:
    from measure.accuracy.rig import BOTH, LEFT, OFF, RIGHT, _by_eyes
    from measure.cases import Measurement

    case = Measurement([str(make_stereo_session(tmp_path / "stereo", bundled_body))]).cases(every_view=True)[0]
    eyes = _by_eyes(case, 0)
    given = {kind: [view.given for view in one.data.views] for kind, one in eyes.items()}
    assert given == {LEFT: [True, False], RIGHT: [False, True], BOTH: [True, True], OFF: [True, True]}
    assert all(one.kind == kind and one.readings == case.readings for kind, one in eyes.items())
    right, wrong = (eyes[kind].data.views[1].view_from_camera for kind in (BOTH, OFF))
    assert np.degrees(rotation_angle(wrong, right)) == pytest.approx(0.3)
    lengths = [np.linalg.norm(pose[:3, 3]) for pose in (right, wrong)]
    assert abs(lengths[1] / lengths[0] - 1) == pytest.approx(0.02)


def test_report_compares_eyes_and_rigs(bundled_body: Body, tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    folder = make_stereo_session(tmp_path / "stereo", bundled_body)
    done = run_here("accuracy", "rig", folder, "--workers", "1", "--json")
    assert done.code == 0, done.err
    report = done.result
    assert [row["estimated from"] for row in report["estimates"]] == [
        "left eye",
        "right eye",
        "both eyes",
        "both, rig off",
    ]
    assert all(row["frames"] == 2 and row["cpu seconds"] > 0 for row in report["estimates"])
    assert report["estimates"][2]["tip_mm"][2] < 1
    (session,) = report["wrong rigs"]
    assert (session["session"], session["frames"], session["right rig named"]) == ("stereo", 2, 0)


@pytest.mark.usefixtures("scripts_on_path")
def test_session_of_one_view_and_two_of_one_name_are_refused(tmp_path: Path) -> None:
    from measure.accuracy.rig import rig_report
    from measure.cases import Measurement

    demo = str(ROOT / "data" / "demo")
    with pytest.raises(InputError, match="expected a stereo session"):
        rig_report(Measurement([demo]), use_joints=True)
    with pytest.raises(InputError, match="got demo twice"):
        Measurement([demo, demo]).cases()
