"""A user's own data: plain pictures, no camera file, masks beside a video under other names."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.made_recordings import HEIGHT, WIDTH, write_video

from dvrk_cmaes import read_frame, read_session
from promises.program import DEMO, run

FRAMES = 4
SMALL = f"width: {WIDTH}\nheight: {HEIGHT}\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n"


def mask(number: int) -> np.ndarray:
    picture = np.zeros((HEIGHT, WIDTH), np.uint8)
    picture[10 : 20 + number, 20:40] = 255
    return picture


@pytest.fixture
def video(tmp_path: Path) -> list[object]:
    """The words that import a video of a few images with readings named from 0000."""
    write_video(tmp_path / "v.avi", FRAMES, code="MJPG")
    (tmp_path / "camera.yaml").write_text(SMALL)
    rows = "".join(f"{k:04d},{0.04 * k},0.1\n" for k in range(FRAMES))
    (tmp_path / "joints.csv").write_text(f"frame,time,jaw\n{rows}")
    files = ("--camera", tmp_path / "camera.yaml", "--joints", tmp_path / "joints.csv")
    return ["import", tmp_path / "v.avi", *files, "--out", tmp_path / "out"]


def given_masks(folder: Path, kind: str, first: int = 0, count: int = FRAMES - 1) -> Path:
    """Write masks of all images but the last, or of a number, those of a data set counted from ``first``."""
    if kind == "video":
        writer = cv2.VideoWriter(str(folder / "m.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25, (WIDTH, HEIGHT))
        for number in range(FRAMES - 1):
            writer.write(cv2.cvtColor(mask(number), cv2.COLOR_GRAY2BGR))
        writer.release()
        return folder / "m.avi"
    if kind == "COCO":
        sizes = {"width": WIDTH, "height": HEIGHT}
        images = [{"id": k, "file_name": f"{first + k:05d}.jpg", **sizes} for k in range(count)]
        parts = [
            {"id": k, "image_id": k, "category_id": 1, "segmentation": [[20, 10, 40, 10, 40, 20 + k, 20, 20 + k]]}
            for k in range(count)
        ]
        document = {"images": images, "annotations": parts, "categories": [{"id": 1, "name": "tool"}]}
        (folder / "m.json").write_text(json.dumps(document))
        return folder / "m.json"
    (folder / "m").mkdir()
    for number in range(FRAMES - 1):
        cv2.imwrite(str(folder / "m" / f"frame_{number:06d}.png"), mask(number))
    return folder / "m"


@pytest.mark.parametrize("kind", ["folder", "video", "COCO"])
def test_masks_are_imported_with_a_video_whose_frames_keep_the_names_of_the_rows(
    video: list[object], tmp_path: Path, kind: str
) -> None:
    ran = run(*video, "--masks", given_masks(tmp_path, kind))
    assert ran.code == 0, ran.err
    assert "masks: 3 of 4 frames" in ran.out
    frames = {frame.name: frame for frame in read_session(tmp_path / "out").frames}
    assert [*frames] == [f"{k:04d}" for k in range(FRAMES)]
    assert [frame.mask is not None for frame in frames.values()] == [True] * 3 + [False]
    assert frames["0002"].readings["jaw"] == pytest.approx(0.1)


def test_data_set_counted_from_1_has_the_masks_of_frames_counted_from_0(video: list[object], tmp_path: Path) -> None:
    assert "m.json, in order from 00001 on" in run(*video, "--masks", given_masks(tmp_path, "COCO", 1, FRAMES)).out
    session = read_session(tmp_path / "out")
    areas = [int(read_frame(files, session.camera).mask.sum()) for files in session.frames]
    assert np.sign(np.diff(areas)).tolist() == [1] * (FRAMES - 1)


@pytest.mark.parametrize(
    ("header", "options"),
    [("timestamp,q1,q2,q3,q4,q5,q6,jaw_angle\n", ()), ("", ("--columns", "time,yaw,-,-,-,-,-,jaw"))],
)
def test_readings_of_other_columns_are_imported_with_a_video(
    video: list[object], tmp_path: Path, header: str, options: tuple[str, ...]
) -> None:
    rows = "".join(f"{0.04 * k},0.2,0.1,0.1,0.3,0,0,0.5\n" for k in range(FRAMES))
    (tmp_path / "joints.csv").write_text(header + rows)
    assert run(*video, *options).code == 0
    read = read_session(tmp_path / "out").frames[1].readings
    assert (read["yaw"], read["jaw"]) == pytest.approx((0.2, 0.5))
    words = ("--columns", "time,x,y,z", "--pose-of", "tip", "--pose-base", "local", "--overwrite")
    assert "--columns: expected --joints of readings" in run(*video, *words).refusal


def test_masks_of_no_image_and_a_video_alone_are_refused_with_all_that_is_missing(
    video: list[object], tmp_path: Path
) -> None:
    (tmp_path / "m").mkdir()
    cv2.imwrite(str(tmp_path / "m" / "other.png"), mask(0))
    assert "m: expected masks of the frames 0000, 0001" in run(*video, "--masks", tmp_path / "m").refusal
    refusal = run("import", tmp_path / "v.avi", "--out", tmp_path / "out").refusal
    assert "--camera, --joints: a video needs" in refusal
    assert "--camera none, then `dvrk-cmaes calibrate` (`dvrk-cmaes help uncalibrated`)" in refusal
    assert not (tmp_path / "out").exists()
    words = [*video[:3], "none", *video[4:]]
    assert f"without a calibration: `dvrk-cmaes calibrate {tmp_path / 'out'}`" in run(*words).out
    assert not (tmp_path / "out" / "camera.yaml").exists()
    assert len(read_session(tmp_path / "out", focal="usual").frames) == FRAMES
    assert "camera.yaml: no such file" in run("batch", tmp_path / "out").refusal


@pytest.mark.parametrize("given", ["", "0003.jpg", "*.jpg"])
def test_plain_pictures_are_a_session_without_readings(tmp_path: Path, quick: Path, given: str) -> None:
    picture = cv2.imread(str(DEMO / "images" / "0003.jpg"))
    cv2.imwrite(str(tmp_path / "0003.jpg"), cv2.resize(picture, (320, 240), interpolation=cv2.INTER_AREA))
    words = ("--camera", DEMO / "camera.yaml", "--config", quick, "--workers", 1)
    ran = run("batch", tmp_path / given, *words, "--out", tmp_path / "out")
    assert ran.code == 3
    assert "no joints.csv, as with --joints none" in ran.err
    assert [path.stem for path in (tmp_path / "out" / "frames").iterdir()] == ["0003"]
    assert run("segment", tmp_path / given, "--out", tmp_path / "found").code in (0, 3)
    assert [path.name for path in (tmp_path / "found" / "masks").iterdir()] == ["0003.png"]


def test_missing_or_superfluous_words_are_refused_with_what_to_do(tmp_path: Path) -> None:
    masks, out = Path(shutil.copytree(DEMO / "masks", tmp_path / "a" / "masks")), ("--out", "x")
    camera = DEMO / "camera.yaml"
    pictures, uncalibrated = DEMO / "images", ["dvrk-cmaes calibrate FOLDER", "dvrk-cmaes help uncalibrated"]
    cases: list[tuple[tuple[object, ...], list[str]]] = [
        (("estimate", masks / "0001.png"), ["by --mask or --image"]),
        (
            ("batch", pictures / "0001.jpg", pictures / "0003.jpg", "--camera", camera, *out),
            [f"unexpected {pictures / '0003.jpg'}: quote a pattern ('a/*.png')"],  # that the shell expanded
        ),
        (
            ("estimate", "--mask", masks / "0001.png", "--camera", camera, "--instrument", 400181),
            ["others by number: `--description DIR`"],
        ),
        (("batch", masks.parent, *out), uncalibrated),
        (("estimate", "--image", pictures / "0001.jpg", *out), uncalibrated),
        (("import", pictures, "--camera", camera, *out), ["needs no import: `dvrk-cmaes batch FOLDER` takes it"]),
    ]
    for words, expected in cases:
        refusal = run(*words, folder=tmp_path).refusal
        assert all(text in refusal for text in expected), refusal
    assert f"{pictures / '0001.jpg'}: image" in run("inspect", pictures / "*1.jpg").out


def demo_as(folder: Path, *formats: str, first: tuple[int, int, int] = (0, 0, 0)) -> Path:
    """Copy the demo's session with other names of masks, images and rows: formats of numbers from ``first``."""
    mask, image, row = formats or ("{:04d}.png", "{:04d}.jpg", "{:04d}")
    for k in range(5):
        names = (f"masks/{k:04d}.png", mask, first[0]), (f"images/{k:04d}.jpg", image, first[1])
        for source, name, offset in names:
            target = (folder / source).parent / name.format(k + offset)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(DEMO / source, target)
    shutil.copy(DEMO / "camera.yaml", folder)
    head, *rows = (DEMO / "joints.csv").read_text().splitlines()
    named = [f"{row.format(k + first[2])},{line.partition(',')[2]}" for k, line in enumerate(rows)]
    (folder / "joints.csv").write_text("\n".join([head, *named]) + "\n")
    return folder


def redraw(folder: Path, change: Callable[[Any], Any], *kinds: str) -> None:
    """Change the pixels of masks or images."""
    for path in [path for kind in kinds for path in (folder / kind).iterdir()]:
        cv2.imwrite(str(path), change(cv2.imread(str(path))))


COUNTED = ("{:05d}.png", "{:05d}.jpg", "{:05d}")


@pytest.mark.parametrize(
    ("names", "first"),
    [
        (("{:04d}.jpg.png", "{:04d}.jpg", "{:04d}"), (0, 0, 0)),
        (("{:04d}_jpg.rf.ab12cd34_mask.png", "{:04d}_jpg.rf.ab12cd34.jpg", "{:04d}"), (0, 0, 0)),
        (("{:04d}_SegmentationMask.png", "{:04d}.jpg", "{:04d}"), (0, 0, 0)),
        (("mask_2024-05-01_{:05d}_seg.png", "{:04d}.jpg", "frame_{:06d}"), (0, 0, 0)),
        (("001/{:05d}.png", "{:04d}.jpg", "{}"), (0, 0, 0)),
        (("SegmentationClass/frame_{:06d}.PNG", "frame{}.JPG", "{:04d}"), (0, 0, 0)),
        (("left_{}.png", "clip_7_{:05d}.jpg", "{:04d}"), (0, 0, 0)),
        # of Label Studio, in order
        (("task-9{}-annotation-7-by-1-tag-needle_driver-0.png", "{:04d}.jpg", "{:04d}"), (0, 0, 0)),
        *((COUNTED, first) for first in ((0, 1, 0), (1, 0, 0), (0, 0, 1))),  # as many, paired in order
    ],
)
def test_masks_images_and_rows_of_one_frame_are_found_by_their_numbers(
    tmp_path: Path, names: tuple[str, str, str], first: tuple[int, int, int]
) -> None:
    folder = demo_as(tmp_path, *names, first=first)
    (folder / "boxes.csv").write_text(f"frame,u,v\nimage_{4 + first[1]},2,3\n")
    (folder / "keypoints.csv").write_text("frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n17,1,2,3,4\n")
    found = read_session(folder)
    assert [files.prompts is not None for files in found.frames] == [False] * 4 + [True]
    assert "not read: keypoints.csv: none of its names or numbers is a frame's" in found.warnings
    assert [Path(names[1].format(k + first[1])).stem for k in range(5)] == [files.name for files in found.frames]
    for files, same in zip(found.frames, read_session(DEMO).frames, strict=True):
        assert files.readings == same.readings
        assert Path(str(files.mask)).read_bytes() == Path(str(same.mask)).read_bytes()
    if any(first):
        assert f"paired in order with as many files {first[1]:05d}, ..." in run("inspect", folder).out


def test_masks_that_pair_with_no_image_are_named_and_two_of_one_image_refused(tmp_path: Path) -> None:
    folder = demo_as(tmp_path)
    mask = (folder / "masks" / "0000.png").read_bytes()
    (folder / "masks" / "other_77.png").write_bytes(mask)
    assert "masks without an image or a row of readings: other_77" in run("inspect", folder).out
    (folder / "masks" / "3.png").write_bytes(mask)  # a task's mask beside them is not that of the number 0
    (folder / "masks" / "other_77.png").rename(folder / "masks" / "task-2-annotation-9-by-1-tag-x-0.png")
    assert "3.png: expected one mask for image 0003, got several" in run("inspect", folder).refusal


def test_masks_and_readings_of_other_names_are_named(tmp_path: Path) -> None:
    folder = demo_as(tmp_path)
    (folder / "masks").rename(folder / "SegmentationClass")  # CVAT's
    assert "of these with masks 5, images 5, readings 5" in run("inspect", folder).out
    redraw(folder, lambda picture: picture * np.array([1, 1, 0], np.uint8), "SegmentationClass")
    assert "of a [[tool]] in session.toml), got the colours #000000, #00ffff" in run("inspect", folder).err
    (folder / "session.toml").write_text('[[tool]]\narm = "PSM1"\nlabel = "#00ffff"\n')
    assert run("inspect", folder).code == 0
    (folder / "session.toml").unlink()
    redraw(folder, lambda picture: picture.max(axis=2), "SegmentationClass")
    (folder / "SegmentationClass").rename(folder / "annotated")
    (folder / "joints.csv").rename(folder / "kinematics.csv")
    ran = run("inspect", folder)
    assert "of these with masks 0, images 5, readings 0" in ran.out
    assert "not read: annotated, kinematics.csv: session.toml can name" in ran.out
    assert "expected readings of yaw, pitch, insertion, roll (joints.csv" in run("calibrate", folder).refusal
    toml = '[[tool]]\narm = "PSM1"\nmasks = "annotated"\njoints = "kinematics.csv"\n'
    (folder / "session.toml").write_text(toml)
    ran = run("inspect", folder)
    assert "with masks 5, images 5, readings 5" in ran.out
    assert "not read" not in ran.out


def test_warnings_of_a_folder_are_on_the_page_and_in_the_summary(tmp_path: Path, quick: Path) -> None:
    folder = demo_as(tmp_path)
    (folder / "joints.csv").rename(folder / "kinematics.csv")
    ran = run("batch", folder, "--frames", "0001", "--config", quick, "--out", tmp_path / "out", "--workers", 1)
    text = "not read: kinematics.csv: session.toml can name"
    assert text in ran.err
    (warning,) = json.loads((tmp_path / "out/summary.json").read_text())["warnings"]
    assert warning.startswith(text)
    assert text in (tmp_path / "out/report.html").read_text()


def test_images_and_their_masks_in_one_folder_are_refused(tmp_path: Path) -> None:
    for k in range(3):
        shutil.copy(DEMO / "images" / f"{k:04d}.jpg", tmp_path)
        shutil.copy(DEMO / "masks" / f"{k:04d}.png", tmp_path / f"{k:04d}_mask.png")
    refusal = run("batch", tmp_path, "--camera", DEMO / "camera.yaml", "--out", tmp_path / "out").refusal
    assert "expected folders images and masks, got both kinds in one: 0000, 0000_mask" in refusal


def test_refused_masks_of_one_reason_are_one_line_and_other_sizes_are_said(tmp_path: Path) -> None:
    folder = demo_as(tmp_path)
    redraw(folder, lambda picture: 255 - picture[..., 0], "masks")
    ran = run("inspect", folder)
    assert ran.code == 3
    assert "0000.png: mask is inverted" in ran.err
    assert ran.err.endswith("(and 4 more like this)\n")
    assert ran.err.count("\n") == 1
    redraw(folder, lambda picture: 255 - picture[..., 0], "masks")
    redraw(folder, lambda picture: cv2.resize(picture, (320, 240), interpolation=cv2.INTER_NEAREST), "masks", "images")
    ran = run("inspect", folder)
    assert ran.code == 0
    assert "the mask is 320 x 240, the calibration 640 x 480: intrinsics rescaled by 0.5" in ran.out


def test_video_beside_its_masks_is_to_be_imported_with_them(video: list[object], tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    cv2.imwrite(str(tmp_path / "masks" / "1.png"), mask(1))
    said = run("inspect", tmp_path).out
    assert f"next: dvrk-cmaes import {tmp_path}/v.avi --camera {tmp_path}/camera.yaml --joints" in said
    assert f"--masks {tmp_path}/masks" in said


def test_camera_file_of_a_known_mistake_and_soft_masks_are_said_by_inspect(tmp_path: Path) -> None:
    folder = demo_as(tmp_path)
    redraw(folder, lambda picture: cv2.GaussianBlur(picture[..., 0], (0, 0), 9), "masks")
    ran = run("inspect", folder)
    assert (ran.code, ran.err) == (0, "")
    assert "masks have many values between 0 and 255: above 127 is instrument" in ran.out
    camera = folder / "camera.yaml"
    camera.write_text(camera.read_text().replace("326.3, 0.0, 1042.6, 235.1", "235.1, 0.0, 1042.6, 326.3"))
    for path in (folder, camera):
        ran = run("inspect", path)
        assert ran.code == 3
        assert f"{path}: camera file: most likely wrong: principal point" in ran.err


def test_column_of_another_name_is_refused_with_the_option_that_names_columns(tmp_path: Path) -> None:
    folder = demo_as(tmp_path)
    table = folder / "joints.csv"
    table.write_text(table.read_text().replace("jaw", "gripper", 1))
    refusal = run("batch", folder, "--out", tmp_path / "out").refusal
    assert "header: unknown joint 'gripper'" in refusal
    assert refusal.endswith("(--columns names columns, - one that is not read)")


def test_folder_of_no_known_kind_is_refused_by_what_is_in_it(tmp_path: Path) -> None:
    (tmp_path / "regular").mkdir()
    shutil.copy(DEMO / "joints.csv", tmp_path / "kinematics.csv")
    expected = "masks or images, or those that session.toml names, or pictures, got kinematics.csv, regular"
    for words in (("inspect",), ("batch", "--camera", DEMO / "camera.yaml")):
        assert expected in run(*words, tmp_path).refusal
    refusal = run("import", tmp_path, "--out", tmp_path / "out").refusal
    assert "this is not a LeRobot data set, a folder of SurgPose, " in refusal


def test_images_of_another_aspect_are_refused_with_the_key_of_session_toml_that_takes_them(tmp_path: Path) -> None:
    folder = demo_as(tmp_path)
    redraw(folder, lambda picture: cv2.resize(picture, (640, 360), interpolation=cv2.INTER_NEAREST), "masks", "images")
    ran = run("inspect", folder)
    assert ran.code == 3
    assert "of a session, crop or stretch of [camera] in session.toml)" in ran.err
    (folder / "session.toml").write_text("[camera]\nstretch = true\n")
    assert run("inspect", folder).code == 0


@pytest.mark.parametrize("name", ["masks.json", "_annotations.coco.json", "annotations/instances_default.json"])
def test_data_set_as_annotators_export_it_has_the_masks_of_the_images(tmp_path: Path, name: str) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "camera.yaml").write_text(SMALL)
    for number in range(FRAMES - 1):
        cv2.imwrite(str(tmp_path / "images" / f"{number:05d}.jpg"), mask(number))
    (tmp_path / name).parent.mkdir(exist_ok=True)
    given_masks(tmp_path, "COCO").rename(tmp_path / name)
    session = read_session(tmp_path)
    assert [int(read_frame(files, session.camera).mask.sum()) > 0 for files in session.frames] == [True] * (FRAMES - 1)
