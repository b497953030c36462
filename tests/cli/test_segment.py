"""``dvrk-cmaes segment``, and ``estimate`` and ``batch`` without masks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import run_command
from helpers.done_once import found_by_model
from helpers.drawn_tools import draw_tool
from helpers.files import read_mask, write_image
from helpers.places import bundled_path
from helpers.sam2_graphs import TOOL, write_export

from dvrk_cmaes import read_session

DEMO = bundled_path("demo")


@pytest.fixture
def image(tmp_path: Path) -> Path:
    write_image(tmp_path / "a.png", draw_tool().image)
    return tmp_path / "a.png"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, shadow in (("0001", 0.0), ("0002", 0.5)):
        write_image(tmp_path / "session" / "images" / f"{name}.png", draw_tool(shadow=shadow).image)
    return tmp_path / "session"


def test_folder_is_segmented_despite_failing_images(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    write_image(folder / "images" / "0003.png", np.full((120, 160, 3), 90, np.uint8))
    (folder / "images" / "0004.png").write_bytes(b"no picture")
    ran = run_command(capsys, "segment", folder, "--out", tmp_path / "out", "--json")
    assert ran.code == 3
    frames = ran.result["frames"]
    assert [frames[name]["status"] for name in sorted(frames)] == ["ok", "ok", "failed", "failed"]
    assert frames["0003"]["reason"].endswith(
        "0003.png: no instrument found; a box or a point on the instrument would help"
    )
    assert sorted(path.name for path in (tmp_path / "out" / "masks").iterdir()) == ["0001.png", "0002.png"]


def test_both_eyes_of_a_stereo_session_are_segmented(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    for side in ("left", "right"):
        (tmp_path / "stereo" / "images" / side).mkdir(parents=True)
        picture = (folder / "images" / "0001.png").read_bytes()
        (tmp_path / "stereo" / "images" / side / "0001.png").write_bytes(picture)
    ran = run_command(capsys, "segment", tmp_path / "stereo", "--out", tmp_path / "out", "--json")
    assert ran.code == 0
    assert set(ran.result["frames"]) == {"left/0001", "right/0001"}
    for side in ("left", "right"):
        assert (tmp_path / "out" / "masks" / side / "0001.png").is_file()
        assert (tmp_path / "out" / "overlays" / side / "0001.jpg").is_file()


def test_masks_of_session_are_never_replaced(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    write_image(folder / "masks" / "0001.png", np.full((240, 320), 255, np.uint8))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    for out in (folder, folder / "images" / ".."):
        ran = run_command(capsys, "segment", folder, "--out", out, "--point", "30,110")
        assert "expected a new or empty folder, or one of an earlier segment, got one with " in ran.refusal
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_mask_that_was_corrected_by_hand_is_not_replaced(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "found"
    assert run_command(capsys, "segment", folder, "--out", out).code in (0, 3)
    assert run_command(capsys, "segment", folder, "--out", out).code in (0, 3)
    mask = out / "masks" / "0001.png"
    write_image(mask, np.full((240, 320), 255, np.uint8))
    before = mask.read_bytes()
    assert run_command(capsys, "segment", folder, "--out", out).refusal == (
        f"{out}: masks/0001.png was not written by `segment`, or changed since; choose another --out, or move it"
    )
    assert mask.read_bytes() == before


def test_images_that_are_segmented_one_by_one_share_a_folder(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "found"
    for name in ("0001", "0002"):
        ran = run_command(capsys, "segment", folder / "images" / f"{name}.png", "--out", out, "--json")
        assert Path(ran.result["frames"][name]["mask"]) == out / "masks" / f"{name}.png"
    assert sorted(path.name for path in (out / "masks").iterdir()) == ["0001.png", "0002.png"]
    written = json.loads((out / "run.json").read_text())["files"]
    assert {name for name in written if name.startswith("masks/")} == {"masks/0001.png", "masks/0002.png"}


def test_guess_is_reported(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    picture = np.full((240, 320, 3), (70, 75, 165), np.uint8)
    cv2.circle(picture, (160, 120), 40, (140, 140, 140), -1)
    write_image(tmp_path / "a.png", picture)
    ran = run_command(capsys, "segment", tmp_path / "a.png", "--out", tmp_path / "out")
    assert ran.code == 3
    assert ran.out.startswith("a: a guess, confidence 0.4")
    assert "  the mask does not come in from the image's border, as instruments do\n" in ran.out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--box", "1,2,3"], "--box: expected x0,y0,x1,y1 in pixels, got '1,2,3'"),
        (["--point", "here"], "--point: expected a pixel u,v, got 'here'"),
        (["--point", "-9,5"], "point: expected a pixel of the 320 x 240 image, got -9,5"),
        (["--model", "sam2"], "--weights: --model sam2 needs the folder of an exported checkpoint, got none"),
        (["--weights", "x"], "--weights: --model classic has none; expected them only with --model sam2"),
        (["--threads", "0"], "--threads: expected a whole number of at least 1, got 0"),
    ],
)
def test_invalid_options_are_refused(
    capsys: pytest.CaptureFixture[str], image: Path, tmp_path: Path, arguments: list[str], expected: str
) -> None:
    assert run_command(capsys, "segment", image, *arguments, "--out", tmp_path / "out").refusal == expected
    assert not (tmp_path / "out").exists()


def test_place_without_images_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run_command(capsys, "segment", tmp_path).refusal == f"{tmp_path}: expected images (PNG or JPEG), got none"
    missing = tmp_path / "a.png"
    assert run_command(capsys, "segment", missing).refusal.startswith(f"{missing}: no such file; expected an image")


def test_masks_by_sam2_are_those_of_the_session(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, found = tmp_path / "session", np.zeros((480, 640), np.bool_)
    found[100:300, 50:400] = True
    found_by_model(monkeypatch, found, 0.7)
    bar = np.full((480, 640, 3), (90, 90, 170), np.uint8)
    bar[150:250, 60:560] = TOOL[::-1]
    write_image(session / "images" / "0000.png", bar)
    for name in ("camera.yaml", "joints.csv"):
        shutil.copy(DEMO / name, session / name)
    weights, out = write_export(tmp_path / "sam2", "onnx-community"), tmp_path / "sam2-masks"
    ran = run_command(capsys, "segment", session, "--model", "sam2", "--weights", weights, "--out", out)
    assert ran.code == 0, ran.err
    assert "asked by box and point of the classic segmentation (confidence 0.70)" in ran.out
    shutil.copytree(out / "masks", session / "masks")
    frame = read_session(session).frames[0]
    assert frame.mask is not None
    mask = read_mask(frame.mask)
    assert mask[155:245, 65:395].all()  # what is in the box of the mask that was found
    assert mask.sum() < 1.05 * 100 * 340
