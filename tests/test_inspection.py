"""Inspection of files and folders: the recognised kind, the summary, and the notes on ambiguous content."""

from __future__ import annotations

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import main
from helpers.files import write_image
from helpers.made_examples import SMALL_CAMERA
from helpers.made_recordings import write_video
from helpers.places import ROOT, bundled_path

from dvrk_cmaes import InputError, SessionCalibration, read_session
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.inspection import Options, inspect_path

DEMO = bundled_path("demo")
MASK = np.zeros((480, 640), np.uint8)
MASK[100:200, 100:164] = 255


def written(folder: Path, name: str, text: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_folder_of_masks_is_described(tmp_path: Path) -> None:
    for name in ("0001", "0002"):
        write_image(tmp_path / f"{name}.png", MASK > 0)
    written(tmp_path, "0003.png", b"\x89PNG\r\n\x1a\n torn")
    written(tmp_path, "notes.txt", "mine")
    found = inspect_path(tmp_path)
    assert found.kind == "folder of pictures"
    assert {"2 of 3: mask, 640 x 480 px", "skipped: notes.txt"} <= {*found.lines}
    assert found.problems[0].startswith(f"{tmp_path}/0003.png: expected an image (PNG or JPEG), got")
    assert all(frame.mask for frame in read_session(tmp_path, camera=DEMO / "camera.yaml").frames)


def test_masks_of_a_session_that_are_empty_full_or_damaged_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "session"
    shutil.copytree(DEMO, folder)
    write_image(folder / "masks" / "0000.png", MASK > 255)
    write_image(folder / "masks" / "0001.png", MASK >= 0)
    (folder / "masks" / "0003.png").write_bytes((folder / "masks" / "0003.png").read_bytes()[:200])
    assert main(["inspect", str(folder)]) == 3
    texts = capsys.readouterr().err.splitlines()
    assert [text.removeprefix(f"dvrk-cmaes: {folder}/masks/")[:23] for text in texts] == [
        "0000.png: mask is empty",
        "0001.png: mask is full:",
        "0003.png: expected a ma",
    ]
    assert main(["inspect", str(DEMO)]) == 0


def message(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        inspect_path(path)
    text = str(caught.value)
    assert "\n" not in text
    return text


# kinds


def test_camera_file_is_summarised() -> None:
    found = inspect_path(DEMO / "camera.yaml")
    assert found.kind == "camera"
    assert found.lines[0] == "ROS camera_info calibration, raw images (camera_matrix and distortion)"
    assert found.read["size"] == (640, 480)
    assert found.notes == ("images are taken for raw ones unless --rectified says otherwise",)
    rectified = inspect_path(DEMO / "camera.yaml", Options(rectified=True))
    assert rectified.lines[0] == "ROS camera_info calibration, rectified images (projection_matrix)"
    assert rectified.notes == ()


def test_readings_are_shown_in_deg_and_mm(tmp_path: Path) -> None:
    path = written(tmp_path, "joints.csv", "frame,time,insertion,jaw,roll\na,10,0.1,0.5,\nb,10.5,0.15,1.0,\n")
    found = inspect_path(path)
    assert found.kind == "joint readings"
    assert found.lines == (
        "joints.csv: 2 rows, in rad (insertion: m)",
        "insertion from 100.00 to 150.00 mm",
        "jaw from 28.65 to 57.30 deg",
        "times from 10.000 to 10.500 s, 2.0 rows a second",
    )
    assert found.read["ranges"] == {"insertion": (0.1, 0.15), "jaw": (0.5, 1.0)}
    assert found.notes[-1] == "a frame's readings are found by its name"


def test_calibration_states_its_status_its_base_and_its_doubts(tmp_path: Path) -> None:
    axes = ("tx", "ty", "tz", "rx", "ry", "rz", "jaw")
    known = SessionCalibration("lnd", np.eye(4), {"jaw": 0.1}, axes, np.eye(7), np.eye(7), {}, ("a",))
    made = replace(known, doubts=("wrong",))
    found = inspect_path(written(tmp_path, "session.json", json.dumps(made.to_dict())))
    first = "doubtful, of 1 frame; arm's base (RCM) in the camera 0.00, 0.00, 0.00 mm"
    assert found.lines == (first, "offset of jaw 5.73 deg", "wrong")


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        ("k.csv", "frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n0001,1,2,3,4.5\n", "jaw tips"),
        ("t.csv", "frame,time\n0001,1.5\n", "image times"),
        ("m.csv", "frame,marker,u,v\n0001,roll_1,1,2\n", "marker detections"),
        ("js.txt", "name: [jaw]\nposition: [0.5]\n---\n", "joint readings"),
        ("c.xml", "<opencv_storage><K1>1 0 0 0 1 0 0 0 1</K1></opencv_storage>", None),
    ],
)
def test_small_files_are_recognised_by_content(tmp_path: Path, name: str, text: str, kind: str | None) -> None:
    path = written(tmp_path, name, text)
    if kind is None:
        assert message(path) == f"{path}: K1: expected a list of numbers, got '1 0 0 0 1 0 0 0 1'"
        return
    found = inspect_path(path)
    assert found.kind == kind
    assert found.lines
    json.dumps(found.to_dict(), allow_nan=False)


def test_session_is_summarised_with_unusable_frames(tmp_path: Path) -> None:
    found = inspect_path(DEMO)
    assert (found.kind, found.read["counts"]["masks"], found.read["counts"]["truth"]) == ("session", 5, 5)
    assert "readings: joints.csv" in found.lines
    folder = Path(shutil.copytree(DEMO, tmp_path / "session"))
    (folder / "joints.csv").write_text("frame,jaw\n0000,0.5\n0001,bad\n")
    problems = inspect_path(folder).read["problems"]
    assert problems == {"0001": f"{folder}/joints.csv: frame 0001: jaw: expected a finite number in rad, got 'bad'"}


def test_real_files_are_recognised(shared: Path) -> None:
    formats = shared / "formats"
    kinds = {
        "camera/*": "camera",
        "recording/*": "joint readings",
        "published_layout/0/frame*": "image",
        "published_layout/0/0*.jpg": "mask",
        "published_layout/0/jo*.npy": "joint readings",
        "published_layout/0/ja*.npy": "joint readings",
    }
    for pattern, kind in kinds.items():
        paths = sorted(formats.glob(pattern))
        assert paths
        for path in paths:
            assert inspect_path(path).kind == kind


# the command


def test_session_of_several_arms_is_described_by_arm(tmp_path: Path) -> None:
    folder, camera = tmp_path / "two", tmp_path / "camera.yaml"
    camera.write_text(SMALL_CAMERA)
    made = ["synth", str(folder), "--arms", "2", "--frames", "2", "--level", "clean", "--camera", str(camera)]
    assert main(made) == 0
    found = inspect_path(folder)
    assert found.kind == "session of 2 arms"
    for arm in ("PSM1", "PSM2"):
        assert f"{arm}: 2 frames: 0000, 0001" in found.lines
        assert found.read["arms"][arm]["counts"]["readings"] == 2


# recordings


def typed(lines: tuple[str, ...]) -> list[str]:
    """Give the command that a finding says to type next; its options must exist."""
    command = shlex.split(lines[0].split("next: dvrk-cmaes ")[1])
    app.parse_args(command, exit_on_error=False, print_error=False)
    return command


def test_video_has_size_count_rate_and_the_command_that_imports_it(tmp_path: Path) -> None:
    write_video(tmp_path / "a b.mp4", code="mp4v")
    found = inspect_path(tmp_path / "a b.mp4")
    assert found.kind == "video"
    assert found.lines[1] == "needed, and not beside it: camera.yaml, joints.csv"
    assert found.lines[2] == "{width} x {height} px, {images} images, {rate:.2f} a second".format(**found.read)
    assert typed(found.lines)[:4] == ["import", str(tmp_path / "a b.mp4"), "--camera", "camera.yaml"]


def test_video_beside_camera_and_readings_is_taken_for_a_recording(tmp_path: Path) -> None:
    write_video(tmp_path / "v.mp4", code="mp4v")
    for name in ("camera.yaml", "joints.csv"):
        (tmp_path / name).touch()
    assert typed(inspect_path(tmp_path / "v.mp4").lines) == ["track", str(tmp_path / "v.mp4")]
    (tmp_path / "labels").mkdir()
    assert typed(inspect_path(tmp_path / "v.mp4").lines)[-4:-2] == ["--masks", str(tmp_path / "labels")]
    (tmp_path / "labels").rmdir()
    shutil.copy(tmp_path / "v.mp4", tmp_path / "v_mask.mp4")
    assert typed(inspect_path(tmp_path / "v.mp4").lines)[-4:-2] == ["--masks", str(tmp_path / "v_mask.mp4")]


def test_session_says_its_clock_and_what_it_is_taken_for(tmp_path: Path) -> None:
    found = inspect_path(ROOT / "data" / "demo")
    assert [line for line in found.lines if line.startswith("clock: ")] == [
        "clock: none; 5 rows of readings, in the order of the frames"
    ]
    assert found.lines[0].startswith("taken for frames of one arm and one camera; next: ")
    assert typed(found.lines) == ["calibrate", str(ROOT / "data" / "demo")]
