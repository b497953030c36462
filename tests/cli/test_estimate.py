"""``dvrk-cmaes estimate`` and ``demo``: output, exit codes, and one line for each wrong usage or input."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.commands import Ran, run_command
from helpers.places import bundled_path

from dvrk_cmaes import DvrkCmaesError

pytestmark = pytest.mark.usefixtures("estimates_shared")

DEMO = bundled_path("demo")
MASK, CAMERA, JOINTS = DEMO / "masks" / "0000.png", DEMO / "camera.yaml", DEMO / "joints.csv"
QUICK = "[search]\nsamples = 128\nstarts = 3\nevaluations = 200\n"
"""Settings for tests that need a result quickly; its accuracy is low."""


Run = Callable[..., Ran]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run a command line in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def go(*arguments: object) -> Ran:
        return run_command(capsys, *arguments)

    return go


def frame(**changes: object) -> list[object]:
    """Give the arguments of a good frame; changes replace options, None removes one, and underscores become hyphens."""
    options: dict[str, object] = {"mask": MASK, "camera": CAMERA, "joints": JOINTS, **changes}
    return [
        "estimate",
        *(part for k, v in options.items() if v is not None for part in (f"--{k.replace('_', '-')}", v)),
    ]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    return write(tmp_path / "quick.toml", QUICK)


# output


def test_reading_outside_limits_gives_warning(run: Run, quick: Path) -> None:
    done = run(*frame(joints="wrist_pitch=1.6,wrist_yaw=-0.55,jaw=0.95", config=quick), "--json")
    assert done.code in (0, 3)
    assert "reading of wrist_pitch: 91.7 deg is outside its limits" in done.err
    assert any("wrist_pitch" in warning for warning in done.result["warnings"])
    assert done.result["readings"]["wrist_pitch"] == 1.6


# usage


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (frame(mask=None), ["--mask"]),
        (frame(search="cma-es"), ["--search", "cmaes", '"cma-es"']),
        (frame(refine="bobyqa"), ["--refine: no option here", "--preset card", "--search"]),
        (frame(label="#12", pick="3,4"), ["--label", "#00ff00", "#12"]),
        (frame(label=70000), ["--label", "0 to 65535", "70000"]),
        (frame(pick="3"), ["--pick", "u,v", "'3'"]),
        (frame(pick="-1,3"), ["0000.png", "pick", "640 x 480", "-1,3"]),
        (frame(keypoints="-1,2,x,3"), ["keypoints: expected four numbers", "'-1,2,x,3'"]),
        (frame(keypoints="1,2,nan,3"), ["--keypoints: expected four numbers", "'1,2,nan,3'"]),
        (frame(pick="nan,3"), ["--pick", "u,v", "'nan,3'"]),
        (frame(package_path="model=nowhere"), ["--package-path", "model", "nowhere"]),
        (frame(shaft_radius=-0.004), ["--shaft-radius: no option here", "radius of the URDF's mesh"]),
        (["demo", "--threads", "0"], ["--threads", "at least 1"]),
    ],
)
def test_wrong_usage_is_refused(run: Run, tmp_path: Path, arguments: list[object], expected: list[str]) -> None:
    done = run(*arguments, "--out", "out")
    assert done.code == 2
    for text in expected:
        assert text in done.complaint
    assert list(tmp_path.iterdir()) == []


# bad input


def test_missing_embree_is_reported_with_install_command(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    copy = Path(shutil.copytree(bundled_path("instruments", "lnd"), tmp_path / "lnd")) / "lnd.urdf"
    copy.write_text(copy.read_text().replace('<robot name="', '<robot name="new_'))  # of which no scene was built
    done = run(*frame(instrument=copy))
    assert done.code == 2
    assert "embreex" in done.complaint
    assert "pip install" in done.complaint


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (MemoryError(), 1, "out of memory"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (DvrkCmaesError("no luck"), 1, "no luck"),
    ],
)
def test_exception_during_run_gives_one_line(
    run: Run, monkeypatch: pytest.MonkeyPatch, raised: BaseException, code: int, said: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr("dvrk_cmaes.runs.frame.estimate_views", fail)
    done = run(*frame())
    assert done.code == code
    assert said in done.complaint


# the demo


def test_demo_compares_frames_with_truth(run: Run, tmp_path: Path) -> None:
    done = run("demo", "--json")
    found = done.result
    assert [one["frame"] for one in found["frames"]] == ["0000", "0001", "0002", "0003", "0004"]
    assert done.code == 0, found
    assert found["right"] is True
    assert all(one["status"] == "ok" and one["errors"]["tip_mm"] < 2 for one in found["frames"])
    assert all(one["seconds"] > 0 for one in found["frames"])
    assert len(list((tmp_path / "dvrk-cmaes-demo" / "overlays").glob("*.jpg"))) == 5
    assert len(list((tmp_path / "dvrk-cmaes-demo" / "frames").glob("*.json"))) == 5


def test_failing_demo_states_errors(run: Run, tmp_path: Path) -> None:
    poor = write(
        tmp_path / "poor.toml", "[search]\nsamples = 1\nstarts = 1\nevaluations = 1\n[refine.outline]\niterations = 1\n"
    )
    done = run("demo", "--config", poor)
    assert done.code == 1
    assert "not as the golden pose" in done.out
    assert "5 of 5" not in done.out


# in a process of its own


def test_help_and_import_load_no_heavy_library() -> None:
    script = (
        "import sys, dvrk_cmaes; from dvrk_cmaes.cli import main; code = main(['--help']);"
        "print([m for m in ('numpy', 'scipy', 'cv2', 'embreex', 'nlopt', 'trimesh') if m in sys.modules]);"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
