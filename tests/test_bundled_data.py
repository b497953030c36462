"""The demo session and the golden cases: complete, readable, consistent with the needle driver, and not made in CI."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.files import read_mask
from helpers.places import SCRIPTS, bundled_path
from helpers.readings import read_joints
from numpy.typing import NDArray

from dvrk_cmaes import Body, Camera, Renderer, load_instrument, read_camera
from dvrk_cmaes.frames.images import read_ignore
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, base_from_root
from dvrk_cmaes.joints.names import WRIST_JOINTS

DEMO = bundled_path("demo")
GOLDEN = bundled_path("golden")
DEMO_TRUTH: dict[str, Any] = json.loads((DEMO / "golden.json").read_text(encoding="utf-8"))
FRAMES: dict[str, Any] = DEMO_TRUTH["frames"]
CASES: dict[str, Any] = json.loads((GOLDEN / "golden.json").read_text(encoding="utf-8"))["cases"]


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.prepare(load_instrument("lnd"))


def rendered(body: Body, camera: Camera, pose: Any, joints: dict[str, float]) -> NDArray[np.bool_]:
    values = np.array([[joints[name] for name in body.instrument.joint_names]])
    return Renderer(body, camera, threads=1).masks(np.array([pose]), values)[0]


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


def case_camera(case: dict[str, Any]) -> Camera:
    return Camera(**{**case["camera"], "distortion": tuple(case["camera"]["distortion"])})


# the demo session


def test_demo_has_five_complete_frames() -> None:
    assert list(FRAMES) == ["0000", "0001", "0002", "0003", "0004"]
    assert sorted(p.name for p in (DEMO / "masks").iterdir()) == [f"{frame}.png" for frame in FRAMES]
    assert sorted(p.name for p in (DEMO / "images").iterdir()) == [f"{frame}.jpg" for frame in FRAMES]
    for frame in FRAMES:
        assert set(read_joints(DEMO / "joints.csv", frame=frame)) == {*WRIST_JOINTS, *OUTER_JOINTS}


@pytest.mark.parametrize("frame", FRAMES)
def test_demo_masks_agree_with_true_poses(body: Body, frame: str) -> None:
    truth = FRAMES[frame]
    silhouette = rendered(body, read_camera(DEMO / "camera.yaml"), truth["T_camera_roll_link"], truth["joints"])
    assert 0.9 < overlap(silhouette, read_mask(DEMO / "masks" / f"{frame}.png")) < 0.99


@pytest.mark.parametrize(("joint", "rms"), [("wrist_pitch", 5.0), ("wrist_yaw", 5.0), ("jaw", 7.5)])
def test_demo_readings_have_stated_errors(joint: str, rms: float) -> None:
    errors = [read_joints(DEMO / "joints.csv", frame=f)[joint] - truth["joints"][joint] for f, truth in FRAMES.items()]
    assert np.rad2deg(np.sqrt(np.mean(np.square(errors)))) == pytest.approx(rms, rel=0.25)


def test_demo_poses_share_one_base() -> None:
    for truth in FRAMES.values():
        pose = np.array(DEMO_TRUTH["camera_from_base"]) @ base_from_root(truth["joints"])
        np.testing.assert_allclose(pose, truth["T_camera_roll_link"], atol=1e-7)


# the golden cases


def test_golden_cases_match_files() -> None:
    assert {p.stem for p in (GOLDEN / "masks").iterdir()} == set(CASES)
    assert {f"ignore/{p.name}" for p in (GOLDEN / "ignore").iterdir()} == {c["ignore"] for c in CASES.values()} - {None}


@pytest.mark.parametrize("name", CASES)
def test_golden_masks_agree_with_true_poses(body: Body, name: str) -> None:
    case = CASES[name]
    mask = read_mask(GOLDEN / case["mask"])
    silhouette = rendered(body, case_camera(case), case["truth"]["camera_from_root"], case["truth"]["joints"])
    assert mask.shape == silhouette.shape
    counts = np.ones_like(mask) if case["ignore"] is None else ~read_ignore(GOLDEN / case["ignore"])
    segmented = name.startswith("wavy") or case["ignore"] is not None
    assert overlap(mask & counts, silhouette & counts) > (0.93 if segmented else 0.998)


# size and origin


def test_bundled_data_is_below_1_2_megabytes() -> None:
    assert sum(p.stat().st_size for p in bundled_path().rglob("*") if p.is_file()) < 1_200_000


@pytest.mark.parametrize("script", ["make_demo_session.py", "make_golden.py"])
def test_bundled_frames_are_not_made_in_ci(script: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, SCRIPTS / script, "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "CI": "true"},
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith(f"{script}: not run in CI")
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
