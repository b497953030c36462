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
from helpers.files import read_image, read_mask
from helpers.places import SCRIPTS, bundled_path
from numpy.typing import NDArray

from dvrk_cmaes import Body, Camera, Renderer, load_instrument, read_camera
from dvrk_cmaes.frames.images import read_ignore
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.joints.reading import OUTER_JOINTS, WRIST_JOINTS, read_joints

DEMO = bundled_path("demo")
GOLDEN = bundled_path("golden")
DEMO_TRUTH: dict[str, Any] = json.loads((DEMO / "golden.json").read_text(encoding="utf-8"))
FRAMES: dict[str, Any] = DEMO_TRUTH["frames"]
CASES: dict[str, Any] = json.loads((GOLDEN / "golden.json").read_text(encoding="utf-8"))["cases"]
READ_CASES = [name for name, case in CASES.items() if case["readings"]]


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.prepare(load_instrument("lnd"))


def rendered(body: Body, camera: Camera, pose: Any, joints: dict[str, float]) -> NDArray[np.bool_]:
    values = np.array([[joints[name] for name in body.instrument.joint_names]])
    return Renderer(body, camera, threads=1).masks(np.array([pose]), values)[0]


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


def bend_errors(readings: dict[str, float], truth: dict[str, float]) -> tuple[float, float]:
    """Give the distances, deg, of the read wrist pitch and yaw from the true ones and from the mirror twin's."""
    read, true = (np.array([q["wrist_pitch"], q["wrist_yaw"]]) for q in (readings, truth))
    return float(np.rad2deg(np.linalg.norm(read - true))), float(np.rad2deg(np.linalg.norm(read + true)))


def case_camera(case: dict[str, Any]) -> Camera:
    return Camera(**{**case["camera"], "distortion": tuple(case["camera"]["distortion"])})


# the demo session


def test_demo_has_five_complete_frames() -> None:
    assert list(FRAMES) == ["0000", "0001", "0002", "0003", "0004"]
    assert sorted(p.name for p in (DEMO / "masks").iterdir()) == [f"{frame}.png" for frame in FRAMES]
    assert sorted(p.name for p in (DEMO / "images").iterdir()) == [f"{frame}.jpg" for frame in FRAMES]
    for frame in FRAMES:
        assert set(read_joints(DEMO / "joints.csv", frame=frame)) == {*WRIST_JOINTS, *OUTER_JOINTS}


def test_demo_images_and_masks_have_camera_size() -> None:
    camera = read_camera(DEMO / "camera.yaml")
    assert (camera.width, camera.height, camera.is_pinhole) == (640, 480, True)
    for frame in FRAMES:
        assert read_mask(DEMO / "masks" / f"{frame}.png").shape == (480, 640)
        assert read_image(DEMO / "images" / f"{frame}.jpg").shape == (480, 640, 3)


@pytest.mark.parametrize("frame", FRAMES)
def test_demo_masks_agree_with_true_poses(body: Body, frame: str) -> None:
    truth = FRAMES[frame]
    silhouette = rendered(body, read_camera(DEMO / "camera.yaml"), truth["T_camera_roll_link"], truth["joints"])
    assert 0.9 < overlap(silhouette, read_mask(DEMO / "masks" / f"{frame}.png")) < 0.99


@pytest.mark.parametrize("frame", FRAMES)
def test_demo_instrument_is_greyer_than_tissue(frame: str) -> None:
    image = read_image(DEMO / "images" / f"{frame}.jpg").astype(float)
    redness = image[..., 2] - image[..., :2].mean(axis=2)
    mask = read_mask(DEMO / "masks" / f"{frame}.png")
    assert redness[mask].mean() < 10 < 30 < redness[~mask].mean()


@pytest.mark.parametrize("frame", FRAMES)
def test_demo_readings_are_nearer_to_truth_than_to_twin(frame: str) -> None:
    to_truth, to_twin = bend_errors(read_joints(DEMO / "joints.csv", frame=frame), FRAMES[frame]["joints"])
    assert to_truth < 0.5 * to_twin
    assert to_twin > 30


@pytest.mark.parametrize(("joint", "rms"), [("wrist_pitch", 5.0), ("wrist_yaw", 5.0), ("jaw", 7.5)])
def test_demo_readings_have_stated_errors(joint: str, rms: float) -> None:
    errors = [read_joints(DEMO / "joints.csv", frame=f)[joint] - truth["joints"][joint] for f, truth in FRAMES.items()]
    assert np.rad2deg(np.sqrt(np.mean(np.square(errors)))) == pytest.approx(rms, rel=0.25)


def test_demo_poses_share_one_base() -> None:
    for truth in FRAMES.values():
        pose = np.array(DEMO_TRUTH["camera_from_base"]) @ base_from_root(truth["joints"])
        np.testing.assert_allclose(pose, truth["T_camera_roll_link"], atol=1e-7)


@pytest.mark.parametrize("frame", FRAMES)
def test_demo_tips_follow_from_pose_and_are_visible(body: Body, frame: str) -> None:
    truth = FRAMES[frame]
    tips, pose = np.array(truth["tips_camera_m"]), np.array(truth["T_camera_roll_link"])
    in_root = body.instrument.tips([truth["joints"][name] for name in body.instrument.joint_names])
    np.testing.assert_allclose(tips, in_root @ pose[:3, :3].T + pose[:3, 3], atol=1e-7)
    pixels = read_camera(DEMO / "camera.yaml").project(tips)
    assert np.all((pixels > 20) & (pixels < [620, 460]))


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


@pytest.mark.parametrize("name", READ_CASES)
def test_golden_readings_are_nearer_to_truth_than_to_twin(name: str) -> None:
    to_truth, to_twin = bend_errors(CASES[name]["readings"], CASES[name]["truth"]["joints"])
    assert to_truth < 0.5 * to_twin


@pytest.mark.parametrize("name", CASES)
def test_doubtful_cases_state_reason(name: str) -> None:
    case = CASES[name]
    assert case["outcome"] in ("ok", "ok-or-doubtful", "doubtful")
    assert (case["reason"] is not None) == (case["outcome"] != "ok")
    assert all(value > 0 for value in case["tolerance"].values())


def test_golden_cases_have_named_properties(body: Body) -> None:
    truth = {name: case["truth"] for name, case in CASES.items()}
    tips = {name: case_camera(CASES[name]).project(t["tips_camera_m"]) for name, t in truth.items()}
    pose = {name: np.array(t["camera_from_root"]) for name, t in truth.items()}
    mask = {name: read_mask(GOLDEN / CASES[name]["mask"]) for name in ("jaws_hidden", "occluded")}
    shaft = body.instrument.shaft
    assert shaft is not None

    assert np.rad2deg(np.arccos(pose["foreshortened"][2, 2])) == pytest.approx(15, abs=0.1)
    assert truth["jaws_edge_on"]["joints"]["jaw"] == 0
    edge_on = truth["jaws_edge_on"]
    links = pose["jaws_edge_on"] @ body.instrument.forward(list(edge_on["joints"].values()))
    hinge = links[body.instrument.jaw_tips[0].link]
    assert abs(hinge[:3, 2] @ hinge[:3, 3]) < np.sin(np.deg2rad(3)) * np.linalg.norm(hinge[:3, 3])
    for u, v in tips["jaws_hidden"].round().astype(int):
        assert mask["jaws_hidden"][v - 8 : v + 9, u - 8 : u + 9].all()
    assert sorted((tips["tip_outside"][:, 0] > 639.5).tolist()) == [False, True]
    straight_part_ends = pose["close_up"] @ [*(shaft.point + shaft.distal_end * shaft.direction), 1.0]
    assert case_camera(CASES["close_up"]).project(straight_part_ends[:3])[0] > 600
    assert CASES["no_readings"]["readings"] == {}
    ignored = read_ignore(GOLDEN / CASES["occluded"]["ignore"])
    hidden = [bool(ignored[v, u]) for u, v in tips["occluded"].round().astype(int)]
    assert sorted(hidden) == [False, True]
    assert not case_camera(CASES["distorted_lens"]).is_pinhole


# size and origin


def test_bundled_data_is_below_one_megabyte() -> None:
    assert sum(p.stat().st_size for p in bundled_path().rglob("*") if p.is_file()) < 1_000_000


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
