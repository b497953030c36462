"""The table of poses: its columns, and numbers that are read back without loss."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dvrk_cmaes.export.pose_texts import table_text
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.results.pose_rows import pose_rows
from dvrk_cmaes.results.result import ExpectedError, Quality, Result

POSE = moved(np.eye(4), [0.01, -0.02, 0.1, 0.3, -0.2, 0.9])
OK = Result(
    "0001",
    "ok",
    (),
    "lnd",
    "roll_link",
    POSE,
    {"wrist_pitch": 0.1, "jaw": 0.5},
    {"wrist_pitch": 0.2, "insertion": 0.12},
    quality=Quality(0.97, 0.1, {}, 0.6, 2.1),
    covariance=np.diag([1e-8, 4e-8, 9e-8, 1e-4, 4e-4, 9e-4, 1e-2, 4e-2]),
    time=12.25,
    tips=(np.array([0.01, -0.02, 0.11]), np.array([0.012, -0.02, 0.11])),
    tips_px=(np.array([400.5, 90.25]), np.array([490.0, 95.0])),
    expected_error=ExpectedError(
        {"jaw_1": 0.6, "jaw_2": 0.7, "mean": 0.5},
        {name: np.array([0.1, 0.2, 0.4]) for name in ("jaw_1", "jaw_2", "mean")},
        1.0,
        0.8,
    ),
    seconds=0.7,
)
FAILED = Result("0,2", "failed", ('no "instrument"', "too small"), "lnd", "roll_link", None, {}, {})


def test_numbers_are_read_back() -> None:
    row, failed = csv.DictReader(io.StringIO(table_text(pose_rows([OK, FAILED]))))
    np.testing.assert_allclose([float(row[f"camera_from_root_{a}_mm"]) for a in "xyz"], 1e3 * POSE[:3, 3], atol=1e-6)
    quaternion = [float(row[f"camera_from_root_q{a}"]) for a in "xyzw"]
    np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), POSE[:3, :3], atol=1e-8)
    assert float(row["wrist_pitch_deg"]) == pytest.approx(np.degrees(0.1), abs=1e-6)
    assert float(row["wrist_pitch_read_deg"]) == pytest.approx(np.degrees(0.2), abs=1e-6)
    assert float(row["insertion_read_mm"]) == 120
    assert [float(row[f"std_{a}_mm"]) for a in ("tx", "ty", "tz")] == [0.1, 0.2, 0.3]
    assert float(row["std_rz_deg"]) == pytest.approx(np.degrees(0.03), abs=1e-6)
    assert float(row["std_jaw_deg"]) == pytest.approx(np.degrees(0.2), abs=1e-6)
    assert (row["iou"], row["contour_px_95"], row["camera_from_base_qw"]) == ("0.97", "2.1", "")
    assert [float(row[f"tip_2_{a}_mm"]) for a in "xyz"] == [12, -20, 110]
    assert [float(row[f"std_tip_1_{a}_mm"]) for a in "xyz"] == [0.1, 0.2, 0.4]
    assert [float(row[f"tip_1_{a}_px"]) for a in "uv"] == [400.5, 90.25]
    assert (row["time"], failed["time"], failed["tip_1_x_mm"], failed["seconds"]) == ("12.25", "", "", "")
    assert failed["frame"] == "0,2"
    assert failed["reasons"] == 'no "instrument"; too small'
    assert {failed[name] for name in ("camera_from_root_x_mm", "jaw_deg", "iou", "std_tx_mm")} == {""}


def test_rows_share_columns_and_order() -> None:
    first, second = pose_rows([FAILED, OK])
    assert list(first) == list(second)
    assert list(first)[:4] == ["frame", "time", "status", "camera_from_root_x_mm"]


def test_end_of_tool_without_jaws_is_one_tip() -> None:
    hook = replace(OK, tips=OK.tips[:1], tips_px=OK.tips_px[:1], expected_error=None)
    (row,) = pose_rows([hook])
    assert (row["tip_1_z_mm"], row["tip_1_u_px"], row["std_tip_1_x_mm"]) == (110, 400.5, None)
    assert "tip_2_x_mm" not in row


def test_no_results_give_empty_text() -> None:
    assert table_text(pose_rows([])) == ""
