"""``dvrk-cmaes estimate`` with other formats of cameras, readings and tools."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.commands import main
from helpers.places import bundled_path

pytestmark = pytest.mark.usefixtures("estimates_shared")

DEMO = bundled_path("demo")
MASK, CAMERA, JOINTS = DEMO / "masks" / "0000.png", DEMO / "camera.yaml", DEMO / "joints.csv"
QUICK = "[search]\nsamples = 128\nstarts = 2\nevaluations = 160\n"


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
