"""The PnP baseline: exact points give the exact pose, readings are used unchanged, and failures state their reason."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import main
from helpers.places import bundled_path

from dvrk_cmaes import Body, FrameFiles, InputError, read_frame, read_results, read_session
from dvrk_cmaes.estimation.pnp.frame import pose_from_markers, pose_from_tips
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.frames.markers import Marker, place_markers, read_detections, read_marker_table

DEMO = bundled_path("demo")
TABLE = read_marker_table(bundled_path("markers", "lnd.json"))
SESSION = read_session(DEMO)
TRUTH = SESSION.truth.frames


def seen_in(body: Body, frame: str) -> dict[str, np.ndarray]:
    """Give the exact pixels of all markers in a frame of the demo session."""
    truth, instrument = TRUTH[frame], body.instrument
    places = place_markers(instrument, np.array([truth.joints[n] for n in instrument.joint_names]), TABLE)
    pose = truth.camera_from_root
    return {n: SESSION.camera.project(pose[:3, :3] @ p + pose[:3, 3]) for n, p in places.items()}


def true_files(frame: str, **parts: object) -> FrameFiles:
    """Give a frame of the demo session whose readings are the true joint positions."""
    return FrameFiles(frame, DEMO / "masks" / f"{frame}.png", readings=TRUTH[frame].joints, **parts)  # type: ignore[arg-type]


def session_with(tmp_path: Path, body: Body, frames: int = 5) -> Path:
    """Write the demo session with exact marker detections in its first frames."""
    folder = Path(shutil.copytree(DEMO, tmp_path / "session"))
    rows = [f"{f},{n},{u:.6f},{v:.6f}" for f in sorted(TRUTH)[:frames] for n, (u, v) in seen_in(body, f).items()]
    (folder / "markers.csv").write_text("\n".join(["frame,marker,u,v", *rows]) + "\n")
    return folder


@pytest.mark.parametrize("solver", ["sqpnp", "ransac"])
def test_exact_points_and_readings_give_exact_pose(bundled_body: Body, solver: str) -> None:
    result = pose_from_markers(
        true_files("0001"),
        SESSION.camera,
        bundled_body.instrument,
        TABLE,
        seen_in(bundled_body, "0001"),
        solver=solver,  # type: ignore[arg-type]
    )
    truth = TRUTH["0001"]
    assert result.camera_from_root is not None
    error = compare_poses(
        bundled_body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
    )
    assert (result.status, result.source) == ("ok", "frame")
    assert error.root_mm < 0.01
    assert error.rotation_deg < 0.01
    assert SESSION.truth.camera_from_base is not None
    np.testing.assert_allclose(result.camera_from_base, SESSION.truth.camera_from_base, atol=1e-4)


def test_ransac_tolerates_swapped_markers(bundled_body: Body) -> None:
    seen = seen_in(bundled_body, "0001")
    seen["roll_1_front"], seen["yaw_1"] = seen["yaw_1"], seen["roll_1_front"]
    off = {}
    for solver in ("sqpnp", "ransac"):
        result = pose_from_markers(
            true_files("0001"),
            SESSION.camera,
            bundled_body.instrument,
            TABLE,
            seen,
            solver=solver,  # type: ignore[arg-type]
        )
        assert result.camera_from_root is not None
        off[solver] = np.linalg.norm(result.camera_from_root[:3, 3] - TRUTH["0001"].camera_from_root[:3, 3])
    assert off["ransac"] < 1e-5 < 1e-3 < off["sqpnp"]


def test_tips_and_shaft_edges_give_pose(bundled_body: Body) -> None:
    tips = SESSION.camera.project(
        bundled_body.instrument.tips([TRUTH["0004"].joints[n] for n in bundled_body.instrument.joint_names])
        @ TRUTH["0004"].camera_from_root[:3, :3].T
        + TRUTH["0004"].camera_from_root[:3, 3]
    )
    files = true_files("0004", keypoints=tips[::-1].copy())
    result = pose_from_tips(read_frame(files, SESSION.camera), bundled_body.instrument)
    truth = TRUTH["0004"]
    assert result.camera_from_root is not None
    error = compare_poses(
        bundled_body.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
    )
    assert error.shaft_deg < 6
    assert error.root_mm < 6
    assert error.roll_deg < 15


@pytest.mark.parametrize(
    ("readings", "count", "reason"),
    [
        (("wrist_pitch", "jaw"), 12, "no reading of wrist_yaw, and points do not determine it"),
        (("wrist_pitch", "wrist_yaw", "jaw"), 3, "3 of the points that are known were seen, at least 4 are needed"),
        (("wrist_pitch", "wrist_yaw", "jaw"), 0, "0 of the points that are known were seen, at least 4 are needed"),
    ],
)
def test_insufficient_frame_fails_with_reason(
    bundled_body: Body, readings: tuple[str, ...], count: int, reason: str
) -> None:
    files = FrameFiles("0001", None, readings={name: TRUTH["0001"].joints[name] for name in readings})
    seen = dict(list(seen_in(bundled_body, "0001").items())[:count])
    result = pose_from_markers(files, SESSION.camera, bundled_body.instrument, TABLE, seen)
    assert (result.status, result.camera_from_root, result.reasons) == ("failed", None, (reason,))


def test_inconsistent_points_are_doubtful(bundled_body: Body) -> None:
    rng = np.random.default_rng(0)
    seen = {name: pixel + rng.uniform(-90, 90, 2) for name, pixel in seen_in(bundled_body, "0001").items()}
    result = pose_from_markers(true_files("0001"), SESSION.camera, bundled_body.instrument, TABLE, seen)
    assert result.status in ("doubtful", "failed")
    assert "px rms" in result.reasons[0] or "behind" in result.reasons[0]


# the command


def test_command_writes_results_in_common_schema(
    bundled_body: Body, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = session_with(tmp_path, bundled_body, frames=4)
    code = main(["pnp", str(folder), "--out", str(tmp_path / "out")])
    out = capsys.readouterr().out
    results = read_results(tmp_path / "out").frames
    assert code == 3
    assert out.splitlines()[-2].startswith("0004: failed, 0 of the points")
    assert out.splitlines()[-1] == f"4 of 5 frames ok; written: {tmp_path / 'out' / 'frames'}"
    assert [result.status for result in results.values()] == ["ok"] * 4 + ["failed"]
    assert results["0000"].joints == {n: SESSION.frames[0].readings[n] for n in bundled_body.instrument.joint_names}


def test_frames_without_tips_fail(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["pnp", str(DEMO), "--out", str(tmp_path), "--points", "tips"]) == 1
    assert capsys.readouterr().out.count("failed, no jaw tips are given (keypoints.csv)") == 5
    assert json.loads((tmp_path / "frames" / "0000.json").read_text())["camera_from_root"] is None


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("markers.csv", "frame,u,v\n", "header: expected frame,marker,u,v, got frame, u, v"),
        ("markers.csv", "frame,marker,u,v\n0,a,1\n", "line 2: expected 4 cells as in the header, got 3"),
        ("markers.csv", "frame,marker,u,v\n0,a,1,x\n", "line 2: v: expected a finite number in pixels, got 'x'"),
        (
            "markers.csv",
            "frame,marker,u,v\n" + "0,a,1,2\n" * 2,
            "line 3: expected each marker once a frame, got 'a' again",
        ),
        ("table.json", "{}", "markers: expected an object of link and position_m by name, got {}"),
        ("table.json", '{"a": {"position_m": [0, 0, 0]}}', "'a': link: expected the name of a link, got nothing"),
        (
            "table.json",
            '{"a": {"link": "x", "position_m": [0, 1]}}',
            "'a': position_m: expected 3 finite numbers in metres, got [0, 1]",
        ),
        (
            "table.json",
            '{"a": {"link": "x", "position_m": [0, 0, 4]}}',
            "'a': position_m: expected metres; this looks like millimetres, got [0, 0, 4]",
        ),
    ],
)
def test_damaged_marker_files_are_refused(tmp_path: Path, name: str, text: str, expected: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        (read_detections if name.endswith("csv") else read_marker_table)(path)
    assert str(caught.value).startswith(f"{path}: {expected}")


def test_unknown_marker_or_link_is_refused(
    bundled_body: Body, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = session_with(tmp_path, bundled_body)
    path = folder / "markers.csv"
    path.write_text(path.read_text() + "0004,roll_9,1,2\n")
    assert main(["pnp", str(folder), "--out", str(tmp_path / "out")]) == 2
    assert f"{path}: marker: expected one of roll_1_front, " in capsys.readouterr().err
    with pytest.raises(InputError, match=r"marker a: link: expected one of roll_link, .*got 'rol_link'"):
        place_markers(bundled_body.instrument, np.zeros(3), {"a": Marker("rol_link", np.zeros(3))})
    assert not (tmp_path / "out").exists()
