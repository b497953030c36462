"""Each format that is read: what `inspect` takes a file for, and a result or a session made of it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from helpers.made_clips import write_clip
from helpers.made_recordings import (
    ARM,
    BEGIN,
    HEIGHT,
    SECOND,
    WIDTH,
    good,
    pixels,
    sweep,
    write_bag,
    write_lerobot,
    write_video,
)

from dvrk_cmaes import prepare, read_camera, read_session
from promises.program import DEMO, ROOT, Ran, run

FX, FY, CX, CY = 893.5, 889.25, 318.5, 241.25
LENS = (-0.21, 0.05, 0.001, -0.002, 0.01)
K = [[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]]
FLAT = [value for row in K for value in row]
MASK = cv2.imread(str(DEMO / "masks" / "0001.png"), cv2.IMREAD_GRAYSCALE) > 127
READ = {"yaw": 0.018, "pitch": -0.111, "insertion": 0.1205, "roll": -1.65, "wrist_pitch": -0.223, "wrist_yaw": 0.557}


def inspected(path: Path, *options: object) -> dict[str, Any]:
    """Give what `inspect --json` says of one file."""
    ran = run("inspect", path, *options, "--json")
    assert ran.code == 0, ran.err
    (found,) = ran.document
    return dict(found)


def estimated(quick: Path, **options: object) -> Ran:
    """Estimate a bundled frame with other files."""
    given = {"mask": DEMO / "masks" / "0001.png", "camera": DEMO / "camera.yaml", "joints": DEMO / "joints.csv"}
    words = []
    for name, value in (given | options).items():
        for one in value if isinstance(value, tuple) else (value,):
            words += [f"--{name.replace('_', '-')}", one]
    return run("estimate", *words, "--config", quick, "--json")


# cameras


def opencv(suffix: str, **matrices: object) -> tuple[str, str]:
    """Give name and text of a file of OpenCV's own FileStorage."""
    storage = cv2.FileStorage(f".{suffix}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, rows in matrices.items():
        storage.write(name, np.array(rows, float))
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    return f"camera.{suffix}", storage.releaseAndGetString()


STEREO = {"K1": K, "D1": [LENS], "K2": K, "D2": [LENS], "R": np.eye(3), "T": [[-5.3], [0.0], [0.0]]}
TOPIC = "height: 480\nwidth: 640\ndistortion_model: plumb_bob\n"
NUMBERS = {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "width": 640, "height": 480}
NUMBERS |= dict(zip(("k1", "k2", "p1", "p2", "k3"), LENS, strict=True))
CAMERAS: dict[str, tuple[str, str]] = {
    "ROS calibration": (
        "camera.yaml",
        f"image_width: 640\nimage_height: 480\ncamera_matrix: {{rows: 3, cols: 3, data: {FLAT}}}\n"
        f"distortion_model: plumb_bob\ndistortion_coefficients: {{rows: 1, cols: 5, data: {list(LENS)}}}\n",
    ),
    "ROS 1 topic": ("camera.yaml", f"{TOPIC}D: {list(LENS)}\nK: {FLAT}\n---\n"),
    "ROS 2 topic": ("camera.yaml", f"{TOPIC}d: {list(LENS)}\nk: {FLAT}\n---\n"),
    "OpenCV YAML": opencv("yml", camera_matrix=K, distortion_coefficients=[LENS]),
    "OpenCV XML": opencv("xml", camera_matrix=K, distortion_coefficients=[LENS]),
    "OpenCV stereo": opencv("yaml", **STEREO),
    "kalibr": (
        "camchain.yaml",
        f"cam0:\n  camera_model: pinhole\n  intrinsics: [{FX}, {FY}, {CX}, {CY}]\n  distortion_model: radtan\n"
        f"  distortion_coeffs: {list(LENS[:4])}\n  resolution: [640, 480]\n",
    ),
    "plain YAML": ("camera.yaml", f"intrinsic: {K}\ndistortion: {list(LENS)}\n"),
    "fx, fy, cx, cy": ("camera.json", json.dumps(NUMBERS)),
    "scripts about OpenCV": ("camera.json", json.dumps({"mtx": K, "dist": [LENS], "image_size": [640, 480]})),
}


@pytest.mark.parametrize("kind", CAMERAS)
def test_camera_file_is_read(tmp_path: Path, kind: str) -> None:
    name, text = CAMERAS[kind]
    path = tmp_path / name
    path.write_text(text)
    assert inspected(path)["kind"] == "camera"
    camera = read_camera(path, size=(640, 480) if kind == "plain YAML" else None)
    np.testing.assert_allclose(camera.matrix, K, atol=1e-9)
    assert camera.distortion[:4] == pytest.approx(LENS[:4], abs=1e-9)
    assert (camera.width, camera.height) == (640, 480)
    points = np.array([[0.1, -0.05, 1.0], [-0.2, 0.1, 1.0]])
    lens = np.array(LENS if kind != "kalibr" else (*LENS[:4], 0.0))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.array(K), lens)[0][:, 0]
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-6)


# readings


def topic(names: list[str], values: list[float], *, ros1: bool = False) -> str:
    stamp = "secs: 100\n    nsecs: 0" if ros1 else "sec: 100\n    nanosec: 0"
    return f"header:\n  stamp:\n    {stamp}\nname: {names}\nposition: {values}\nvelocity: []\neffort: []\n---\n"


NAMES, VALUES = list(READ), list(READ.values())
ROW = ",".join(map(str, VALUES))
READINGS: dict[str, tuple[str, str, dict[str, object]]] = {
    # name and content of the file, more options; the frame is 0001, its image of 100 s
    "joints.csv": ("joints.csv", f"frame,{','.join(NAMES)}\n0001,{ROW}\n0002,{ROW}\n", {}),
    "columns of an arm": ("joints.csv", f"frame,{','.join(f'PSM1_{n}' for n in NAMES)}\n0001,{ROW}\n", {}),
    "semicolons and decimal commas": (
        "joints.csv",
        f"frame;{';'.join(NAMES)}\n0001;{ROW.replace(',', ';').replace('.', ',')}\n",
        {},
    ),
    "no header": ("joints.csv", f"0001,{ROW}\n0002,{ROW}\n", {"columns": f"frame,{','.join(NAMES)}"}),
    "ROS 1 topic": ("measured_js.yaml", topic(NAMES, VALUES, ros1=True), {"time": 100}),
    "ROS 2 topic": ("measured_js.yaml", topic(NAMES, VALUES), {"time": 100}),
    "data_collection": (
        "measured.csv",
        "# Topic: /PSM1/measured_js\n# Type: sensor_msgs/msg/JointState\n"
        f"timestamp,{','.join(f'name.{k}' for k in range(6))},{','.join(f'position.{k}' for k in range(6))}\n"
        f"100000000000,{','.join(NAMES)},{ROW}\n100020000000,{','.join(NAMES)},{ROW}\n",
        {"time": 100},
    ),
    "rostopic echo -p": (
        "measured.csv",
        f"%time,field.header.seq,{','.join(f'field.{name}{k}' for name in ('name', 'position') for k in range(6))}\n"
        f"100000000000,1,{','.join(NAMES)},{ROW}\n",
        {"time": 100},
    ),
    "measured_q": (
        "measured.csv",
        f"traj_index,{','.join(f'measured_q{k}' for k in range(1, 7))}\n0,0,0,0,0,0,0\n1,{ROW}\n",
        {},
    ),
    "times": ("joints.csv", f"time,{','.join(NAMES)}\n99.99,{ROW}\n100.01,{ROW}\n", {"time": 100}),
}


@pytest.mark.parametrize("kind", READINGS)
def test_readings_are_read(tmp_path: Path, quick: Path, kind: str) -> None:
    name, content, options = READINGS[kind]
    (tmp_path / name).write_text(content)
    more = [word for key, value in options.items() if key == "columns" for word in (f"--{key}", value)]
    assert inspected(tmp_path / name, *more)["kind"] == "joint readings"
    ran = estimated(quick, joints=(tmp_path / name, "jaw=0.835"), **options)
    assert ran.code in (0, 3), ran.err
    assert ran.document["readings"] == pytest.approx(READ | {"jaw": 0.835}, abs=1e-6)


def test_readings_far_from_the_time_of_the_image_are_refused(tmp_path: Path, quick: Path) -> None:
    name, content, _ = READINGS["times"]
    for later, time in ((100.01, 100.5), (100.01, 99.9), (100.2, 100.1)):  # the last one in a gap
        (tmp_path / name).write_text(content.replace("100.01", str(later)))
        assert "within 0.05 s" in estimated(quick, joints=tmp_path / name, time=time).refusal


def test_published_layout_is_read(shared: Path, quick: Path, tmp_path: Path) -> None:
    folder = shared / "formats" / "published_layout"
    camera = shared / "frames" / "real" / "easy" / "camera.yaml"
    assert inspected(folder / "0", "--camera", camera)["kind"] == "session"
    ran = run("batch", folder / "0", "--camera", camera, "--out", tmp_path / "out", "--config", quick, "--workers", 1)
    assert ran.code in (0, 3), ran.err
    result = json.loads((tmp_path / "out" / "frames" / "0026.json").read_text())
    assert len(result["readings"]) == 7


# masks


def runs(mask: np.ndarray) -> dict[str, Any]:
    """Give COCO's run lengths, by columns, of a mask."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], edges, [mask.size]]))
    return {"size": list(mask.shape), "counts": [int(count) for count in counts]}


def test_masks_of_every_kind_give_the_same_result(tmp_path: Path, quick: Path) -> None:
    plain = estimated(quick).document
    bits = np.where(MASK, 255, 0).astype(np.uint8)
    left = np.arange(640) < 450
    colours = np.zeros((*MASK.shape, 3), np.uint8)
    colours[MASK] = (0, 255, 0)
    colours[:9, :9] = (255, 0, 0)
    annotation = {"id": 1, "image_id": 1, "category_id": 7, "segmentation": runs(MASK), "iscrowd": 1}
    size = {"width": 640, "height": 480}
    images = [{"id": k, "file_name": f"000{k}.png", **size} for k in (0, 1)]
    data_set = {"images": images, "annotations": [annotation], "categories": [{"id": 7, "name": "tool"}]}
    other = bits.copy()
    other[470:, :30] = 255  # a second tool
    (outline, *_), _ = cv2.findContours(bits, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    shape = {"label": "tool", "shape_type": "polygon", "points": outline[:, 0].tolist()}
    labelme = {"shapes": [shape], "imageWidth": 640, "imageHeight": 480, "imagePath": "0001.jpg"}
    kinds: dict[str, tuple[object, dict[str, object]]] = {
        "bits.png": (bits, {}),
        "soft.jpg": (bits, {}),
        "labels.png": (np.where(MASK, 3, np.where(np.arange(640) < 40, 1, 0)), {"label": 3}),
        "parts.png": (np.where(MASK, np.where(left, 10, 20), 0), {"label": "10,20"}),
        "any.png": (np.where(MASK, 5, 0), {"label": "any"}),
        "inverted.png": (np.where(MASK, 0, 9), {"label": 0}),
        "colours.png": (colours, {"label": "#00ff00"}),
        "runs.json": (runs(MASK), {}),
        "annotation.json": (annotation, {}),
        "data_set.json": (data_set, {"label": "tool"}),
        "picked.png": (other, {"pick": "500,200"}),
        "polygons.json": (labelme, {}),  # of pixels' centres, by which the outline is rounded
    }
    for name, (content, options) in kinds.items():
        path = tmp_path / name
        if isinstance(content, np.ndarray):
            cv2.imwrite(str(path), content.astype(np.uint8))
        else:
            path.write_text(json.dumps(content))
        found = estimated(quick, mask=path, frame="0001", **options)
        assert found.code in (0, 3), (name, found.err)
        if name == "polygons.json":
            assert np.linalg.norm(np.subtract(found.document["tips"], plain["tips"]), axis=1).max() < 1e-3
        else:
            assert found.document["camera_from_root"] == plain["camera_from_root"], name


# instruments


def test_instrument_is_found_by_package(tmp_path: Path, quick: Path) -> None:
    source = ROOT / "data" / "instruments" / "lnd"
    shutil.copytree(source, tmp_path / "robots" / "parts")
    urdf = (source / "lnd.urdf").read_text().replace('filename="', 'filename="package://parts/')
    (tmp_path / "own.urdf").write_text(urdf)
    options = {"instrument": tmp_path / "own.urdf", "package_path": f"parts={tmp_path / 'robots' / 'parts'}"}
    found, bundled = estimated(quick, **options), estimated(quick)
    assert found.document["camera_from_root"] == bundled.document["camera_from_root"]
    words = ("inspect", tmp_path / "own.urdf", "--package-path", options["package_path"], "--json")
    assert run(*words).document[0]["kind"] == "instrument (URDF)"
    (tmp_path / "own.urdf").rename(tmp_path / "robots" / "instrument_400999.urdf")
    words = ("batch", DEMO, "--instrument", 400999, "--description", tmp_path / "robots", "--frames", "0001")
    session = run(*words, "--config", quick, "--out", tmp_path / "out", "--workers", 1)
    assert session.code in (0, 3)
    result = json.loads((tmp_path / "out" / "frames" / "0001.json").read_text())
    assert result["camera_from_root"] == bundled.document["camera_from_root"]


def test_published_instruments_are_prepared(shared: Path) -> None:
    urdfs = sorted((shared / "instruments" / "dvrk_model").rglob("*.urdf"))
    assert len(urdfs) == 5
    for path in urdfs:
        assert prepare(path).instrument.shaft_radius
    assert inspected(urdfs[0])["kind"] == "instrument (URDF)"


def test_tool_of_the_dvrk_limits_the_joints(shared: Path, quick: Path) -> None:
    tool = shared / "formats" / "tool" / "LARGE_NEEDLE_DRIVER_420006.json"
    used = estimated(quick, tool=tool).document["config"]["instrument"]
    assert (used["limits_from"], used["roll_offset"]) == (tool.name, 0.467)
    wrong = shared / "formats" / "tool" / "PROGRASP_FORCEPS_400093.json"
    assert "another tool" in estimated(quick, tool=wrong).refusal


def test_sessions_masks_and_truth_are_inspected(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "labels.png"), np.where(MASK, 3, 1))
    kinds = {DEMO: "session", DEMO / "golden.json": "known poses (golden.json)", DEMO / "masks" / "0001.png": "mask"}
    for path, kind in (kinds | {tmp_path / "labels.png": "mask of labels"}).items():
        assert inspected(path)["kind"] == kind


# recordings become session folders

SMALL = "width: 64\nheight: 48\nK: [80, 0, 31.5, 0, 80, 22, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\n"
TABLE = [[10.0 + k / 25, *sweep(BEGIN + k * SECOND // 25), 0.5] for k in range(10)]


def table(folder: Path) -> Path:
    """Write readings by time."""
    lines = [",".join(map(str, row)) for row in TABLE]
    (folder / "joints.csv").write_text("\n".join([f"time,{','.join(ARM)},jaw", *lines]) + "\n")
    return folder / "joints.csv"


def surgpose(folder: Path) -> Path:
    """Write a folder in the layout of SurgPose, of two frames."""
    (folder / "regular").mkdir(parents=True)
    for side in ("left", "right"):
        write_video(folder / "regular" / f"{side}_video.mp4", frames=2, rate=30.0, code="mp4v")
    readings = {str(k): {arm: sweep(BEGIN + k * SECOND // 30) for arm in ("PSM1", "PSM3")} for k in range(2)}
    (folder / "api_jp_data.yaml").write_text(yaml.safe_dump(readings))
    eye = {"res_x": WIDTH, "res_y": HEIGHT, "fc_x": 80.0, "fc_y": 80.0, "cc_x": 31.5, "cc_y": 22.0}
    eye |= {f"kc_{k}": 0.0 for k in range(8)}
    pose = {f"R_{k}": float(k % 4 == 0) for k in range(9)} | {"T_0": -5.3, "T_1": 0.0, "T_2": 0.0}
    eyes = {"StereoLeft": eye, "StereoRight": eye | pose}
    lines = [line for name, of in eyes.items() for line in (f"[{name}]", *(f"{key} = {of[key]}" for key in of))]
    (folder / "StereoCalibrationDVRK.ini").write_text("\n".join(lines))
    return folder


def videos(folder: Path) -> Path:
    """Write the videos of a stereo endoscope, with the pose of the right eye."""
    folder.mkdir()
    moved = "right_from_left: [[1, 0, 0, -0.0053], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    for side, more in (("left", ""), ("right", moved)):
        write_video(folder / f"{side}.avi")
        (folder / f"{side}.yaml").write_text(SMALL + "distortion_model: plumb_bob\n" + more)
    table(folder)
    return folder


Made = Callable[[Path], tuple[list[object], int]]
RECORDINGS: dict[str, Made] = {
    # the words of `import`, and how many frames become of them
    "ROS 1": lambda folder: ([write_bag(folder / "bag", "ros1", good())], 5),
    "ROS 2, sqlite3": lambda folder: ([write_bag(folder / "bag", "sqlite3", good())], 5),
    "ROS 2, MCAP": lambda folder: ([write_bag(folder / "bag", "mcap", good())], 5),
    "SurgSync": lambda folder: ([write_clip(folder / "clip"), "--arm", "PSM1"], 4),
    "SurgPose": lambda folder: ([surgpose(folder / "000000"), "--arm", "PSM1", "--side", "both"], 2),
    "LeRobot": lambda folder: (
        [write_lerobot(folder / "set", [row[1:] for row in TABLE]), "--arm", "PSM1", "--camera", folder / "small.yaml"],
        10,
    ),
    "video": lambda folder: (
        [
            *(write_video(folder / "v.avi"), "--camera", folder / "small.yaml"),
            *("--joints", table(folder), "--video-start", "10"),
        ],
        10,
    ),
    "two videos": lambda folder: ([videos(folder / "videos"), "--side", "both", "--video-start", "10"], 10),
}


@pytest.mark.parametrize("kind", RECORDINGS)
def test_recording_becomes_a_session(tmp_path: Path, kind: str) -> None:
    (tmp_path / "small.yaml").write_text(SMALL)
    words, count = RECORDINGS[kind](tmp_path)
    if kind in ("ROS 1", "ROS 2, sqlite3", "ROS 2, MCAP", "LeRobot", "video"):
        ran = run("inspect", words[0])
        assert (ran.code, "next: dvrk-cmaes import" in ran.out) == (0, True)
    ran = run("import", *words, "--out", tmp_path / "session")
    assert ran.code == 0, ran.err
    session = read_session(tmp_path / "session")
    assert len(session.frames) == count
    assert session.camera.width == WIDTH
    assert session.view_names == (("left", "right") if kind in ("SurgPose", "two videos") else session.view_names[:1])
    for k, files in enumerate(session.frames):
        assert set(files.readings) >= set(ARM)
        if kind not in ("SurgPose", "LeRobot"):
            image = cv2.imread(str(files.image))
            np.testing.assert_array_equal(image, pixels(k))  # nothing is lost
    assert inspected(tmp_path / "session")["kind"] == "session"
    again = run("import", *words, "--out", tmp_path / "session")
    assert again.code == 2  # what is there is not replaced


def test_readings_of_a_recording_are_interpolated_to_its_images(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", "mcap", good())
    assert run("import", bag, "--out", tmp_path / "session").code == 0
    for k, files in enumerate(read_session(tmp_path / "session").frames):
        expected = sweep(BEGIN + k * SECOND // 10)
        assert [files.readings[name] for name in ARM] == pytest.approx(expected, abs=1e-5)
        assert files.readings["jaw"] == pytest.approx(0.25 * k / 10 - 0.25 * 0.003, abs=1e-5)
    kept = run("import", bag, "--lag", "0.04", "--out", tmp_path / "late")
    assert kept.code == 0, kept.err
    files = read_session(tmp_path / "late").frames[2]
    assert files.readings["yaw"] == pytest.approx(sweep(BEGIN + 2 * SECOND // 10 - SECOND // 25)[0], abs=1e-5)
