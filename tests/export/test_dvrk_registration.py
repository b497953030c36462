"""`dvrk-cmaes export --to dvrk`: entries for the configuration of the dVRK's versions, and fixed setup joints."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.canned_results import BASE, canned, write_results
from helpers.commands import Ran, run_command
from scipy.spatial.transform import Rotation

from dvrk_cmaes.export.dvrk_registration import registration_files
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.geometry import apply, moved
from dvrk_cmaes.io.json_file import read_json_object

NAMES = FrameNames("PSM2", "endoscope_left_optical", "PSM2_base")
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
ECM_POSE = moved(np.eye(4), [0.01, -0.02, 0.15, 0.3, -0.2, 1.1])

Run = Callable[..., Ran]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Run ``dvrk-cmaes export --to dvrk`` on a result, into a folder ``exports``."""
    out = write_results(tmp_path / "out", canned("0001"))
    return partial(run_command, capsys, "export", out, "--to", "dvrk", "--out", tmp_path / "exports")


def documents(**options: Any) -> dict[str, dict[str, Any]]:
    return {name: json.loads(text) for name, text in registration_files(BASE, NAMES, **options).items()}


@pytest.mark.parametrize(
    ("version", "base_frame", "reference_frame"),
    [("2.4", "base_frame", "reference_frame"), ("2.3", "base-frame", "reference-frame")],
)
def test_entry_has_keys_of_version_only(version: str, base_frame: str, reference_frame: str) -> None:
    entry = documents(version=version)["PSM2-registration-dVRK.json"]
    assert list(entry) == [base_frame]
    assert list(entry[base_frame]) == [reference_frame, "transform"]
    assert entry[base_frame][reference_frame] == "endoscope_left_optical"
    np.testing.assert_array_equal(entry[base_frame]["transform"], FLIP @ BASE)


def test_open_cv_file_is_labelled_and_read_by_dvrk_camera_registration() -> None:
    for version in ("2.4", "2.3"):
        document = documents(version=version)["PSM2-registration-open-cv.json"]
        np.testing.assert_array_equal(document["base-frame"]["transform"], BASE)
        assert document["base-frame"]["reference-frame"] == "endoscope_left_optical"
        assert document["convention"].startswith("OpenCV: camera_from_base")


def test_newest_version_is_default(run: Run, tmp_path: Path) -> None:
    assert run().code == 0
    assert set(json.loads((tmp_path / "exports/PSM1-registration-dVRK.json").read_text())) == {"base_frame"}
    assert run("--dvrk-version", "2.3").code == 0
    assert set(json.loads((tmp_path / "exports/PSM1-registration-dVRK.json").read_text())) == {"base-frame"}


def test_entry_pasted_into_real_system_file_is_read_back(shared: Path, tmp_path: Path) -> None:
    (sample,) = (shared / "formats" / "dvrk-2.4").glob("system-*.json")
    text = sample.read_text()
    pasted = registration_files(BASE, NAMES)["PSM2-registration-dVRK.json"].strip().removeprefix("{").removesuffix("}")
    entry = re.compile(r'("name": "PSM2".*?)"base_frame": \{.*?\]\]\s*\}', re.DOTALL)
    edited, count = entry.subn(lambda match: match[1] + pasted.strip(), text, count=1)
    assert count == 1
    assert "// see https://dvrk.readthedocs.io" in edited
    (tmp_path / "system.json").write_text(edited)
    before, after = (
        {arm["name"]: arm for arm in read_json_object(path, expected="a system file", comments=True)["arms"]}
        for path in (sample, tmp_path / "system.json")
    )
    np.testing.assert_array_equal(after["PSM2"]["base_frame"]["transform"], FLIP @ BASE)
    assert set(after["PSM2"]) == set(before["PSM2"])
    assert set(after["PSM2"]["base_frame"]) == set(before["PSM2"]["base_frame"])
    assert {name: arm for name, arm in after.items() if name != "PSM2"} == {
        name: arm for name, arm in before.items() if name != "PSM2"
    }


def test_open_cv_file_has_fields_of_real_sample(shared: Path) -> None:
    sample = json.loads((shared / "formats" / "registration" / "PSM2_registration.json").read_text())
    ours = documents()["PSM2-registration-open-cv.json"]
    assert set(sample) <= set(ours)
    assert set(sample["base-frame"]) == set(ours["base-frame"])
    assert np.shape(sample["base-frame"]["transform"]) == np.shape(ours["base-frame"]["transform"])


def test_fixed_setup_joints_replace_base_frame() -> None:
    files = documents(ecm_pose=ECM_POSE)
    assert list(files) == ["PSM2-registration-open-cv.json", "suj-fixed.json"]
    ecm, psm = files["suj-fixed.json"]["arms"]
    assert (ecm["name"], psm["name"]) == ("ECM", "PSM2")
    np.testing.assert_array_equal(ecm["measured_cp"], np.eye(4))


def test_fixed_setup_joints_agree_with_points_seen_by_camera() -> None:
    """A point of the arm's base, mapped step by step: to the camera, to the dVRK's axes, to the base of the ECM."""
    points = np.random.default_rng(0).normal(0, 0.1, (10, 3))
    in_camera = apply(BASE, points)
    in_ecm_base = apply(ECM_POSE, in_camera * [-1, -1, 1])
    found = np.array(documents(ecm_pose=ECM_POSE)["suj-fixed.json"]["arms"][1]["measured_cp"])
    np.testing.assert_allclose(apply(found, points), in_ecm_base, atol=1e-12)


def test_fixed_setup_joints_have_fields_of_real_sample(shared: Path) -> None:
    sample = read_json_object(
        shared / "formats" / "dvrk-2.4" / "suj-fixed.json", expected="fixed setup joints", comments=True
    )
    ours = documents(ecm_pose=ECM_POSE)["suj-fixed.json"]
    assert set(ours) == set(sample)
    assert {key for arm in ours["arms"] for key in arm} == {key for arm in sample["arms"] for key in arm}
    assert sample["arms"][0] == {**ours["arms"][0]}


def message(kind: str) -> str:
    """Text of the pose of the ECM as a message that a topic prints, or as a matrix."""
    x, y, z = ECM_POSE[:3, 3].tolist()
    qx, qy, qz, qw = Rotation.from_matrix(ECM_POSE[:3, :3]).as_quat().tolist()
    vector, quaternion = {"x": x, "y": y, "z": z}, {"x": qx, "y": qy, "z": qz, "w": qw}
    header = {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "ECM_base"}
    fields: dict[str, Any] = {
        "PoseStamped": {"header": header, "pose": {"position": vector, "orientation": quaternion}},
        "TransformStamped": {"header": header, "transform": {"translation": vector, "rotation": quaternion}},
        "matrix": {"name": "ECM", "measured_cp": ECM_POSE.tolist()},
    }[kind]
    return json.dumps(fields) + ("\n---\n" if kind != "matrix" else "")


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped", "matrix"])
def test_pose_of_endoscope_arm_is_read_from_file(kind: str, run: Run, tmp_path: Path) -> None:
    path = tmp_path / "ecm.yaml"
    path.write_text(message(kind))
    assert run("--ecm-pose", path).code == 0
    arms = json.loads((tmp_path / "exports" / "suj-fixed.json").read_text())["arms"]
    np.testing.assert_allclose(arms[1]["measured_cp"], ECM_POSE @ FLIP @ BASE, atol=1e-9)


def test_number_without_point_is_read(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "ecm.yaml"
    path.write_text("pose: {position: {x: 1e-05, y: 0, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 1}}\n")
    assert run("--ecm-pose", path).code == 0
    arms = json.loads((tmp_path / "exports" / "suj-fixed.json").read_text())["arms"]
    assert arms[1]["measured_cp"][0][3] == pytest.approx(1e-5 - BASE[0, 3], abs=1e-9)


def test_wrong_pose_of_endoscope_arm_is_refused(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "ecm.yaml"
    path.write_text("a: 1\n")
    assert run("--ecm-pose", path).refusal.startswith(f"{path}: expected a pose measured_cp (PoseStamped")
    path.write_text("pose: {position: {x: 0, y: 0, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 0}}\n")
    assert run("--ecm-pose", path).refusal == (
        f"{path}: pose.orientation: expected a unit quaternion x, y, z, w, got [0.0, 0.0, 0.0, 0.0]"
    )
    path.write_text("pose: {position: {x: 0, y: abc, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 1}}\n")
    assert run("--ecm-pose", path).refusal == f"{path}: pose.position.y: expected a finite number, got 'abc'"
    path.write_text("measured_cp: [[1, 0], [0, 1]]\n")
    assert run("--ecm-pose", path).refusal == (
        f"{path}: measured_cp: expected 4 rows of 4 finite numbers, got [[1, 0], [0, 1]]"
    )
    assert run("--ecm-pose", tmp_path / "none").refusal.startswith(
        f"{tmp_path / 'none'}: no such file; expected a pose"
    )
    assert run("--ecm-pose", path, "--to", "tf").code == 2
