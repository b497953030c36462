"""``dvrk-cmaes estimate`` and ``demo``: output, exit codes, and one line for each wrong usage or input."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import Ran, run_command
from helpers.instrument_files import mesh_link, write_urdf

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.io.bundled import bundled_path

pytestmark = pytest.mark.usefixtures("estimates_shared")

DEMO = bundled_path("demo")
MASK, CAMERA, JOINTS = DEMO / "masks" / "0000.png", DEMO / "camera.yaml", DEMO / "joints.csv"
CAMERA_TEXT = CAMERA.read_text(encoding="utf-8")
QUICK = "[search]\nsamples = 128\nstarts = 3\nevaluations = 65\n"
"""Settings for tests that need a result quickly; its accuracy is low."""

RESULT_FIELDS = [
    *(
        "schema",
        "frame",
        "time",
        "status",
        "reasons",
        "instrument",
        "shaft_radius",
        "root_link",
        "camera_from_root",
        "joints",
        "readings",
    ),
    *(
        "tips",
        "tips_px",
        "warnings",
        "remarks",
        "unused",
        "camera_from_base",
        "source",
        "change",
        "quality",
        "std",
        "covariance",
    ),
    *("mode_probability", "tip_probability", "alternatives"),
    *("seconds", "evaluations", "rays", "seed", "version", "config"),
]


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


def picture(path: Path, pixels: np.ndarray) -> Path:
    path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    return path


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    return write(tmp_path / "quick.toml", QUICK)


# output


def test_good_frame_writes_result_and_overlay(run: Run, tmp_path: Path) -> None:
    done = run(*frame(image=DEMO / "images" / "0000.jpg", out="out"), "--json")
    assert (done.code, done.err) == (0, "")
    assert list(done.result) == RESULT_FIELDS
    assert (done.result["schema"], done.result["frame"], done.result["status"]) == (1, "0000", "ok")
    assert (tmp_path / "out/frames/0000.json").read_text(encoding="utf-8") == done.out
    overlay = cv2.imread(str(tmp_path / "out/overlays/0000.jpg"))
    assert overlay.shape[1] == 1280
    assert sorted(p.name for p in (tmp_path / "out").rglob("*") if p.is_file()) == [
        "0000.jpg",
        "0000.json",
        "run.json",
    ]


def test_text_output_lists_pose_joints_and_files(run: Run, quick: Path) -> None:
    done = run(*frame(config=quick, out="out"))
    assert done.code == 0
    lines = done.out.splitlines()
    assert re.fullmatch(r"0000: tips within \d+\.\d+ mm \(90 %\), ok", lines[0])
    assert any(line.startswith("roll_link in the camera (x right, y down, z forward)") for line in lines)
    assert any("axis-angle, deg" in line for line in lines)
    pitch = next(line.split() for line in lines if line.strip().startswith("wrist_pitch"))
    assert float(pitch[3]) == pytest.approx(np.rad2deg(0.826268), abs=0.01)
    assert float(pitch[1]) - float(pitch[3]) == pytest.approx(float(pitch[4]), abs=0.011)
    assert any("mirror twin" in line for line in lines)
    assert lines[-2:] == ["written: out/frames/0000.json", "written: out/overlays/0000.jpg"]
    assert "\x1b" not in done.out


def test_outer_readings_give_base_of_either_arm(run: Run, quick: Path) -> None:
    classic, si = (
        np.array(run(*frame(config=quick, arm=arm), "--json").result["camera_from_base"]) for arm in ("classic", "si")
    )
    offset = np.linalg.inv(classic) @ si
    np.testing.assert_allclose(offset[:3, :3], np.eye(3), atol=1e-6)
    assert np.linalg.norm(offset[:3, 3]) == pytest.approx(0.4826 - 0.4318, abs=1e-6)


def test_result_without_readings_is_doubtful(run: Run, quick: Path) -> None:
    done = run(*frame(joints="none", config=quick), "--json")
    assert done.code == 3
    assert done.result["status"] == "doubtful"
    assert any("readings" in reason for reason in done.result["reasons"])
    assert done.result["readings"] == {}


def test_half_size_mask_rescales_camera_with_warning(run: Run, quick: Path, tmp_path: Path) -> None:
    half = picture(
        tmp_path / "0000.png", cv2.resize(cv2.imread(str(MASK), 0), (320, 240), interpolation=cv2.INTER_AREA)
    )
    done = run(*frame(mask=half, config=quick), "--json")
    note = "the mask is 320 x 240, the calibration 640 x 480: intrinsics rescaled by 0.5"
    assert done.err == f"dvrk-cmaes: warning: {note}\n"
    assert note in done.result["warnings"]
    assert done.result["remarks"] == [note]
    assert done.result["quality"]["iou"] > 0.9


def test_reading_outside_limits_gives_warning(run: Run, quick: Path) -> None:
    done = run(*frame(joints="wrist_pitch=1.6,wrist_yaw=-0.55,jaw=0.95", config=quick), "--json")
    assert done.code in (0, 3)
    assert "reading of wrist_pitch: 91.7 deg is outside its limits" in done.err
    assert any("wrist_pitch" in warning for warning in done.result["warnings"])
    assert done.result["readings"]["wrist_pitch"] == 1.6


def test_label_pick_and_ignored_pixels_select_mask(run: Run, quick: Path, tmp_path: Path) -> None:
    mask = cv2.imread(str(MASK), 0) > 127
    blob = np.zeros_like(mask)
    blob[400:470, 20:120] = True
    labels = picture(tmp_path / "labels.png", np.where(mask, 3, np.where(blob, 5, 0)).astype(np.uint8))
    both = picture(tmp_path / "both.png", np.where(mask | blob, 255, 0).astype(np.uint8))
    ignore = picture(tmp_path / "ignore.png", np.where(blob, 255, 0).astype(np.uint8))
    v, u = np.argwhere(mask)[len(np.argwhere(mask)) // 2]
    common: dict[str, object] = {"config": quick, "frame": "0000"}
    alone = run(*frame(**common), "--json").result
    for options in ({"mask": labels, "label": 3}, {"mask": both, "pick": f"{u},{v}"}):
        assert run(*frame(**common, **options), "--json").result["camera_from_root"] == alone["camera_from_root"]
    ignored = run(*frame(**common, mask=both, ignore=ignore), "--json").result
    np.testing.assert_allclose(ignored["camera_from_root"], alone["camera_from_root"], atol=2e-3)


def test_flags_equal_settings_and_override_them(run: Run, tmp_path: Path) -> None:
    file = write(tmp_path / "own.toml", f"seed = 5\nthreads = 1\n{QUICK}method = 'crs2'\n[refine]\nmethod = 'sbplx'\n")
    other = write(tmp_path / "other.toml", f"seed = 7\nthreads = 2\n{QUICK}method = 'esch'\n")
    by_file = run(*frame(config=file), "--json").result
    by_flags = run(*frame(config=other, seed=5, threads=1, search="crs2", refine="sbplx"), "--json").result
    assert by_file.pop("seconds") > 0
    assert by_flags.pop("seconds") > 0
    assert by_file == by_flags
    assert by_file["config"]["seed"] == by_file["seed"] == 5
    assert by_file["config"]["search"] == {**by_file["config"]["search"], "method": "crs2", "samples": 128, "starts": 3}


# usage


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["estmate"], ["estmate", "estimate"]),
        (frame(mask=None), ["--mask"]),
        (frame(camera=None), ["--camera"]),
        (frame(joints=None), ["--joints"]),
        (frame(sed=1), ["--sed", "--seed"]),
        (frame(arm="s"), ["--arm", "classic", "si"]),
        (frame(seed="x"), ["--seed", "x"]),
        (frame(seed=-1), ["--seed", "at least 0", "-1"]),
        (frame(threads=0), ["--threads", "at least 1", "0"]),
        (frame(search="cma-es"), ["--search", "cmaes", "'cma-es'"]),
        (frame(refine="bobiqa"), ["--refine", "expected one of bobyqa", "'bobiqa'"]),
        (frame(label="#12", pick="3,4"), ["--label", "#00ff00", "#12"]),
        (frame(label=70000), ["--label", "0 to 65535", "70000"]),
        (frame(pick="3"), ["--pick", "u,v", "'3'"]),
        (frame(pick="-1,3"), ["0000.png", "pick", "640 x 480", "-1,3"]),
        (frame(keypoints="1,2,3"), ["keypoints", "u1,v1,u2,v2", "got 3"]),
        (frame(keypoints="-1,2,x,3"), ["keypoints", "finite", "'x'"]),
        (frame(package_path="model"), ["--package-path", "NAME=DIR", "'model'"]),
        (frame(package_path="model=nowhere"), ["--package-path", "model", "nowhere"]),
        (frame(shaft_radius=-0.004), ["shaft_radius", "positive", "-0.004"]),
        (["demo", "--threads", "0"], ["--threads", "at least 1"]),
    ],
)
def test_wrong_usage_is_refused(run: Run, tmp_path: Path, arguments: list[object], expected: list[str]) -> None:
    done = run(*arguments, *(["--out", "out"] if "estmate" not in arguments else []))
    assert done.code == 2
    for text in expected:
        assert text in done.complaint
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", [[], ["estimate"], ["demo"]])
def test_help_shows_example(run: Run, command: list[str]) -> None:
    done = run(*command, "--help")
    assert (done.code, done.err) == (0, "")
    assert "dvrk-cmaes demo" in done.out or "dvrk-cmaes estimate --mask" in done.out


# bad input


def _files(folder: Path) -> dict[str, Path]:
    """Write one wrong file of each kind."""
    mask = cv2.imread(str(MASK), 0)
    soft = mask // 3
    cube = "\n".join(f"v {x} {y} {z}" for x in (0, 9) for y in (0, 9) for z in (0, 9))
    return {
        "broken": _bytes(folder / "broken.png", MASK.read_bytes()[:500]),
        "text": write(folder / "text.png", "not a picture"),
        "empty": picture(folder / "empty.png", 0 * mask),
        "full": picture(folder / "full.png", np.full_like(mask, 255)),
        "faint": picture(folder / "faint.png", soft),
        "deep": picture(folder / "deep.png", mask.astype(np.uint16) * 257),
        "cropped": picture(folder / "cropped.png", mask[:400]),
        "no_matrix": write(folder / "no_matrix.yaml", CAMERA_TEXT.replace("camera_matrix", "matrix")),
        "zero_focal": write(folder / "zero_focal.yaml", CAMERA_TEXT.replace("1042.6", "0.0")),
        "negative_focal": write(folder / "negative_focal.yaml", CAMERA_TEXT.replace("1042.6", "-1042.6")),
        "nan": write(folder / "nan.yaml", CAMERA_TEXT.replace("326.3", ".nan")),
        "degrees": write(folder / "degrees.csv", "frame,wrist_pitch,jaw\n0000,47.3,54.0\n"),
        "column": write(folder / "column.csv", "frame,wrist_pich\n0000,0.8\n"),
        "settings": write(folder / "settings.toml", "[search]\nsampels = 3\n"),
        "kind": write(folder / "kind.toml", "[refine.outline]\nblur = 'much'\n"),
        "zero_samples": write(folder / "zero_samples.toml", "[search]\nsamples = 0\n"),
        "method": write(folder / "method.toml", "[search]\nmethod = 'cmeas'\n"),
        "no_link": write_urdf(folder, '<link name="shaft"/>', "no_link.urdf"),
        "no_mesh": write_urdf(folder, mesh_link("package://model/away.stl"), "no_mesh.urdf"),
        "pointer": write_urdf(folder, mesh_link("pointer.stl"), "pointer.urdf"),
        "pointer_mesh": write(
            folder / "pointer.stl", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
        ),
        "hollow": write_urdf(folder, mesh_link("hollow.obj"), "hollow.urdf"),
        "hollow_mesh": write(folder / "hollow.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        "huge": write_urdf(folder, mesh_link("huge.obj"), "huge.urdf"),
        "huge_mesh": write(folder / "huge.obj", f"{cube}\nf 1 2 3\nf 2 3 4\nf 5 6 7\nf 1 5 6\n"),
        "file": write(folder / "file", ""),
    }


def _bytes(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("option", "which", "expected"),
    [
        ("mask", "missing.png", ["missing.png", "no such file", "mask"]),
        ("mask", ".", ["directory", "mask"]),
        ("mask", "broken", ["broken.png", "cut off or damaged"]),
        ("mask", "text", ["text.png", "expected a mask (PNG or JPEG)"]),
        ("mask", "empty", ["empty.png", "mask is empty", "127"]),
        ("mask", "full", ["full.png", "mask is full", "background"]),
        ("mask", "faint", ["faint.png", "mask is empty", "85"]),
        ("mask", "deep", ["deep.png", "not 8-bit", "16 bits"]),
        ("mask", "cropped", ["cropped.png", "640 x 480", "640 x 400"]),
        ("image", "cropped", ["cropped.png", "640 x 480", "640 x 400"]),
        ("ignore", "cropped", ["cropped.png", "640 x 480", "640 x 400"]),
        ("camera", "missing.yaml", ["missing.yaml", "no such file", "camera"]),
        ("camera", "no_matrix", ["no_matrix.yaml", "camera_matrix", "missing"]),
        ("camera", "zero_focal", ["zero_focal.yaml", "camera_matrix", "positive focal lengths", "fx 0"]),
        ("camera", "negative_focal", ["negative_focal.yaml", "camera_matrix", "positive focal lengths", "-1042.6"]),
        ("camera", "nan", ["nan.yaml", "camera_matrix", "finite", "nan"]),
        ("joints", "missing.csv", ["missing.csv", "no such file", "joints.csv"]),
        ("joints", "wrist_pich=0.8", ["joints", "'wrist_pich'", "expected one of wrist_pitch"]),
        ("joints", "column", ["column.csv", "'wrist_pich'", "expected one of wrist_pitch"]),
        ("joints", "wrist_pitch=47.3", ["joints", "wrist_pitch", "radians", "47.3", "looks like degrees"]),
        ("joints", "degrees", ["degrees.csv", "0000", "wrist_pitch", "radians", "looks like degrees"]),
        ("frame", "0007", ["joints.csv", "frame", "0000, 0001", "'0007'"]),
        ("config", "settings", ["settings.toml", "search.sampels", "search.samples"]),
        ("config", "kind", ["kind.toml", "refine.outline.blur", "a number", "'much'"]),
        ("config", "zero_samples", ["zero_samples.toml", "search.samples", "above 0", "got 0"]),
        ("config", "method", ["method.toml", "search.method", "cmaes", "'cmeas'"]),
        ("instrument", "lnnd", ["lnnd", "no such URDF", "lnd"]),
        ("instrument", "no_link", ["no_link.urdf", "'roll_link'", "shaft"]),
        ("root-link", "rol_link", ["lnd.urdf", "'rol_link'", "roll_link"]),
        ("instrument", "no_mesh", ["no_mesh.urdf", "package://model/away.stl", "tried", "--package-path"]),
        ("instrument", "pointer", ["pointer.stl", "Git LFS"]),
        ("instrument", "hollow", ["hollow.obj", "empty"]),
        ("instrument", "huge", ["huge.obj", "millimetres"]),
        ("out", "file", ["file", "folder"]),
    ],
)
def test_bad_input_is_refused_without_output(
    run: Run, tmp_path: Path, option: str, which: str, expected: list[str]
) -> None:
    files = _files(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    done = run(*frame(**{"out": tmp_path / "out", option: files.get(which, which)}))
    assert done.code == 2
    for text in expected:
        assert text in done.complaint
    assert sorted(tmp_path.rglob("*")) == before


def test_frame_name_must_be_valid_file_name(run: Run, tmp_path: Path) -> None:
    done = run(*frame(joints="jaw=0.9", frame="../up", out="out"))
    assert done.code == 2
    assert "frame" in done.complaint
    assert "'../up'" in done.complaint
    assert list(tmp_path.iterdir()) == []


def test_missing_embree_is_reported_with_install_command(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    done = run(*frame(shaft_radius=0.00421))  # of which no scene was built before
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
    assert found["expected"] is True
    assert all(one["status"] == "ok" and one["tip_mm"] < 2 for one in found["frames"])
    assert all(one["iou"] > 0.9 and one["seconds"] > 0 for one in found["frames"])
    assert len(list((tmp_path / "dvrk-cmaes-demo" / "overlays").glob("*.jpg"))) == 5
    assert len(list((tmp_path / "dvrk-cmaes-demo" / "frames").glob("*.json"))) == 5


def test_demo_prints_error_beside_stated_one(run: Run) -> None:
    heading, columns, *rows = run("demo").out.splitlines()
    assert heading.startswith("Error (found - true)")
    assert columns.split()[:4] == ["frame", "status", "tip", "stated"]
    assert all(float(row.split()[2]) < 2 * float(row.split()[3]) for row in rows[:5])
    assert rows[5].startswith("5 of 5 frames within the limits")


def test_failing_demo_states_deviations(run: Run, tmp_path: Path) -> None:
    poor = write(
        tmp_path / "poor.toml", "[search]\nsamples = 1\nstarts = 1\nevaluations = 1\n[refine.outline]\niterations = 1\n"
    )
    done = run("demo", "--config", poor)
    assert done.code == 1
    assert "beyond the limit" in done.out
    assert "5 of 5" not in done.out


# in a process of its own


def _program(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "import sys; from dvrk_cmaes.cli import main; sys.exit(main())", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **environment})


def test_exit_code_is_given_to_shell(tmp_path: Path) -> None:
    done = _program(*map(str, frame(joints="wrist_pitch=47")))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("dvrk-cmaes: joints: wrist_pitch: ")
    assert "Traceback" not in done.stderr


def test_help_and_import_load_no_heavy_library() -> None:
    script = (
        "import sys, dvrk_cmaes; from dvrk_cmaes.cli import main; code = main(['--help']);"
        "print([m for m in ('numpy', 'scipy', 'cv2', 'embreex', 'nlopt', 'trimesh') if m in sys.modules]);"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
