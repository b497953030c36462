"""``dvrk-cmaes estimate`` with other formats of cameras, readings and tools."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dvrk_cmaes.cli import main
from dvrk_cmaes.io.bundled import bundled_path

pytestmark = pytest.mark.usefixtures("estimates_shared")

DEMO = bundled_path("demo")
MASK, CAMERA, JOINTS = DEMO / "masks" / "0000.png", DEMO / "camera.yaml", DEMO / "joints.csv"
READ = {"wrist_pitch": 0.826268, "wrist_yaw": -0.555, "jaw": 0.95}
QUICK = "[search]\nsamples = 128\nstarts = 2\nevaluations = 64\n"


def estimate(capsys: pytest.CaptureFixture[str], **options: object) -> tuple[int, str, str]:
    """Run with options; a tuple repeats an option."""
    arguments = ["estimate"]
    for name, value in {"mask": MASK, "camera": CAMERA, "joints": JOINTS, **options}.items():
        for one in value if isinstance(value, tuple) else (value,):
            arguments += [f"--{name.replace('_', '-')}", str(one)]
    code = main([*arguments, "--json"])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK)
    return path


def stamped(path: Path, names: list[str], readings: dict[str, float], seconds: int) -> Path:
    """Write two messages of a topic, 40 ms apart."""
    messages = [
        f"header:\n  stamp:\n    sec: {seconds}\n    nanosec: {nanosec}\nname: [{', '.join(names)}]\n"
        f"position: [{', '.join(str(readings[name] + shift) for name in names)}]\n---\n"
        for nanosec, shift in ((0, -0.1), (40_000_000, 0.1))
    ]
    path.write_text("".join(messages))
    return path


def test_topic_dumps_are_interpolated_to_image_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: Path
) -> None:
    arm = stamped(tmp_path / "measured_js.yaml", ["wrist_pitch", "wrist_yaw"], READ, 100)
    jaw = stamped(tmp_path / "jaw_measured_js.yaml", ["jaw"], READ, 100)
    code, out, err = estimate(capsys, joints=(arm, jaw), time="100.02", config=quick)
    assert (code in (0, 3), err) == (True, "")
    assert json.loads(out)["readings"] == pytest.approx(READ)
    assert estimate(capsys, joints=(arm, jaw), time="100.5")[::2] == (
        2,
        f"dvrk-cmaes: {arm}: frame 0000: wrist_pitch: expected readings before and after the image's time 100.500 s, "
        "within 0.05 s, got the nearest 0.460 s away\n",
    )
    assert "expected the image's time (images.csv, or --time)" in estimate(capsys, joints=(arm, jaw))[2]
    assert estimate(capsys, joints=arm, time="noon")[2] == (
        "dvrk-cmaes: --time: time: expected a finite number of seconds, got 'noon'\n"
    )


def test_assumptions_are_warnings_of_result(capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: Path) -> None:
    camera, joints = tmp_path / "plain.yaml", tmp_path / "measured.csv"
    camera.write_text("intrinsic: [[900, 0, 320], [0, 900, 240], [0, 0, 1]]\ndistortion: [0, 0, 0, 0, 0]\n")
    columns = ",".join(f"measured_q{k}" for k in range(1, 7))
    joints.write_text(f"traj_index,{columns}\n0,0.1,0.2,0.15,0.3,0.8,-0.5\n1,0,0,0,0,0,0\n")
    code, out, err = estimate(capsys, camera=camera, joints=(joints, "jaw=0.9"), config=quick)
    assert code in (0, 3)
    warnings = [
        "the camera file states no image size: taken to be 640 x 480, that of the frames",
        "frame 0000 is taken for row 0 of measured.csv, by its number",
    ]
    assert json.loads(out)["warnings"][:2] == warnings
    assert json.loads(out)["readings"]["jaw"] == 0.9
    assert err == "".join(f"dvrk-cmaes: warning: {text}\n" for text in warnings)


def test_side_selects_camera_of_stereo_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    camera = tmp_path / "stereo.yaml"
    camera.write_text("%YAML:1.0\nK1: [900, 0, 320, 0, 900, 240, 0, 0, 1]\nD1: [0, 0, 0, 0, 0]\nK2: 1\n")
    assert estimate(capsys, camera=camera, side="right")[::2] == (
        2,
        f"dvrk-cmaes: {camera}: K2 (or M2, camera_matrix_right): missing\n",
    )
    code, _, err = estimate(capsys, camera=camera, side="middle")
    assert (code, "left" in err and "right" in err and "middle" in err) == (2, True)


def test_published_frame_is_estimated_with_tool_limits(
    capsys: pytest.CaptureFixture[str], shared: Path, quick: Path
) -> None:
    folder = shared / "formats" / "published_layout" / "0"
    tool = shared / "formats" / "tool" / "LARGE_NEEDLE_DRIVER_420006.json"
    code, out, _ = estimate(
        capsys,
        mask=folder / "00026.jpg",
        image=folder / "frame0026.png",
        camera=shared / "frames" / "real" / "easy" / "camera.yaml",
        joints=(folder / "joint_0026.npy", folder / "jaw_0026.npy"),
        tool=tool,
        config=quick,
    )
    assert code in (0, 3)
    result = json.loads(out)
    assert len(result["readings"]) == 7
    used = result["config"]["instrument"]
    assert (used["limits_from"], used["roll_offset"], used["arm"]) == (tool.name, 0.467, "classic")
    assert np.degrees(used["limits"]["jaw"]) == pytest.approx([-20, 80], abs=1e-3)
    wrong = shared / "formats" / "tool" / "PROGRASP_FORCEPS_400093.json"
    assert estimate(capsys, tool=wrong)[2] == (
        f"dvrk-cmaes: {wrong.name}: wrist_yaw: expected A 9.10 mm as in lnd, got 10.70 mm: another tool\n"
    )
