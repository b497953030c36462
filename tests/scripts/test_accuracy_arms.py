"""scripts/accuracy.py arm-bases: how far the bases of arms.json are from where the arms truly are to each other."""

from __future__ import annotations

import numpy as np
import pytest

from dvrk_cmaes.geometry import moved


@pytest.mark.usefixtures("scripts_on_path")
@pytest.mark.parametrize("steered", [False, True])
def test_bases_are_compared_in_that_of_the_reference_arm(steered: bool) -> None:
    from measure.accuracy.arms import base_rows

    first = moved(np.eye(4), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    relative = moved(np.eye(4), [0.2, 0.0, 0.1, 0.3, 0.2, 0.1])
    poses = {"PSM1": first, "PSM2": first @ relative}
    golden = {
        arm: {"endoscope": {"ecm_from_base": pose.tolist()}} if steered else {"camera_from_base": pose.tolist()}
        for arm, pose in poses.items()
    }
    found = moved(relative, [0.003, 0.0, 0.004, 0.0, np.deg2rad(1.0), 0.0])
    covariance = np.diag([0.002**2] * 3 + [np.deg2rad(0.25) ** 2] * 3)
    arms = {"PSM2": {"reference_from_base": found.tolist(), "covariance": covariance.tolist()}}
    (row,) = base_rows({"reference": "PSM1", "arms": arms}, golden)
    assert row["off, mm"] == pytest.approx(5.0, rel=0.02)
    assert row["off, deg"] == pytest.approx(1.0)
    assert row["std, mm"] == pytest.approx(2 * 3**0.5)
    assert row["largest, std"] == pytest.approx(4.0)
