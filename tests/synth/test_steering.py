"""A steered endoscope: its readings and its truth give the camera of each frame, and the instrument stays in view."""

from __future__ import annotations

import csv
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.moving_worlds import SMALL
from helpers.transforms import inverse

from dvrk_cmaes import Body
from dvrk_cmaes.geometry import log_rotation
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.instrument.endoscope import ecm_from_tip_and_jacobian
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.recording import write_recording
from dvrk_cmaes.synth.session import SessionPlan
from dvrk_cmaes.synth.steering import Steering


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_camera_is_moved_three_times_within_the_stated_range(seed: int) -> None:
    steering = Steering.draw(seed, 200)
    stands = steering.camera_from_first[[0, 74, 124, 199]]
    for before, after in pairwise(stands):
        relative = before @ inverse(after)
        assert 5 <= 1e3 * np.linalg.norm(relative[:3, 3]) <= 30
        assert 5 <= np.degrees(np.linalg.norm(log_rotation(relative[:3, :3]))) <= 25


def test_readings_and_truth_give_each_frames_base(bundled_body: Body, tmp_path: Path) -> None:
    plan = SessionPlan(bundled_body, SMALL, LEVELS["easy"], "video", 9, 4, {}, steered=True)
    write_recording(tmp_path / "recording", plan)
    golden = json.loads((tmp_path / "recording" / "golden.json").read_text(encoding="utf-8"))
    with (tmp_path / "recording" / "joints.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    truth = golden["endoscope"]
    offsets = np.array([truth["offsets"][name] for name in ECM_JOINTS])
    read = np.array([[float(row[name]) for name in ECM_JOINTS] for row in rows]) + offsets
    hand_eye, arm = np.array(truth["tip_from_camera"]), np.array(truth["ecm_from_base"])
    bases = inverse(ecm_from_tip_and_jacobian(read)[0] @ hand_eye) @ arm
    for row, base in zip(rows, bases, strict=True):
        own = golden["frames"][row["frame"]]
        exact = np.array(own["camera_from_base"])
        root = np.array(own["T_camera_roll_link"])
        outer = np.array([own["joints"][name] for name in ("yaw", "pitch", "insertion", "roll")])
        assert np.allclose(
            exact @ base_from_root(outer, roll_offset=bundled_body.instrument.roll_offset), root, atol=1e-8
        )
        turned = np.degrees(np.linalg.norm(log_rotation(base[:3, :3].T @ exact[:3, :3])))
        assert 0 < turned < 2.0  # the errors of the readings, 0.3 deg a joint
    assert np.allclose(golden["camera_from_base"], golden["frames"]["0000"]["camera_from_base"])
