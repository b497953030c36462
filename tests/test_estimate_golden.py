"""The golden cases: the estimate is within each case's tolerances of the truth, or doubtful for the stated reason.

``ok``: the status is ok and the pose within tolerance. ``ok-or-doubtful``: the pose is within tolerance, or the status
doubtful. ``doubtful``: the status is doubtful for the reason of the case, and the pose within tolerance.
``either_twin``: the mirror twin of the truth is accepted too, since the case cannot distinguish them.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.files import read_mask
from helpers.places import bundled_path

from dvrk_cmaes import Body, Camera, EstimateConfig, Result, estimate
from dvrk_cmaes.evaluate import Tolerance
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses
from dvrk_cmaes.frames.images import read_ignore

GOLDEN = bundled_path("golden")
CASES: dict[str, Any] = json.loads((GOLDEN / "golden.json").read_text(encoding="utf-8"))["cases"]
MOST_EVALUATIONS = 3000
"""Largest number of silhouettes that a case may render."""


def run_case(body: Body, case: dict[str, Any], config: EstimateConfig | None = None) -> Result:
    camera = Camera(**{**case["camera"], "distortion": tuple(case["camera"]["distortion"])})
    ignore = None if case["ignore"] is None else read_ignore(GOLDEN / case["ignore"])
    return estimate(read_mask(GOLDEN / case["mask"]), camera, case["readings"], body, ignore=ignore, config=config)


def error_of(body: Body, case: dict[str, Any], result: Result) -> PoseError:
    """Give the error from the truth, or from its mirror twin if that is nearer and the case accepts it."""
    instrument = body.instrument
    assert result.camera_from_root is not None
    true_pose = np.array(case["truth"]["camera_from_root"])
    true_joints = case["truth"]["joints"]
    truths = [(true_pose, true_joints)]
    if case["either_twin"]:
        pose, joints = instrument.twin(true_pose, [true_joints[name] for name in instrument.joint_names])
        truths.append((pose, dict(zip(instrument.joint_names, joints.tolist(), strict=True))))
    found = result.camera_from_root, result.joints
    return min((compare_poses(instrument, found, truth) for truth in truths), key=lambda error: error.rotation_deg)


@pytest.mark.parametrize("name", CASES)
def test_golden_case_is_within_tolerances(bundled_body: Body, name: str) -> None:
    case = CASES[name]
    result = run_case(bundled_body, case)
    error = error_of(bundled_body, case, result)
    beyond = [each.quantity for each in error.measured(Tolerance(**case["tolerance"])) if each.exceeds]
    report = f"{case['about']}: {result.status} {result.reasons}; beyond tolerance: {beyond}; {error}"

    assert result.evaluations <= MOST_EVALUATIONS, report
    if case["outcome"] == "ok":
        assert result.status == "ok", report
        assert not beyond, report
    elif case["outcome"] == "doubtful":
        assert result.status == "doubtful", report
        assert any(case["reason"] in reason for reason in result.reasons), report
        assert not beyond, report
    else:
        assert case["outcome"] == "ok-or-doubtful"
        assert result.status == "doubtful" or not beyond, report


@pytest.mark.parametrize("name", ["clean_1", "distorted_lens", "occluded"])
def test_card_preset_is_within_the_tolerances_of_golden_cases(bundled_body: Body, name: str) -> None:
    config, case = EstimateConfig(), CASES[name]
    result = run_case(bundled_body, case, replace(config, refine=replace(config.refine, derivatives="differences")))
    error = error_of(bundled_body, case, result)
    assert result.status == "ok", result.reasons
    assert not any(each.exceeds for each in error.measured(Tolerance(**case["tolerance"])))
    assert result.rays > 10_000
