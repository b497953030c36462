"""Files as other laboratories have them: each is read with the right value, or refused with the remedy.

A case writes files into a folder and returns the command line that reads them there. Right is that it succeeds and says
something, or refuses in one line that names the remedy; both are given as a regular expression of the output.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pytest
import yaml
from helpers.canned_results import EXPECTED_ERROR, canned
from helpers.commands import run_command
from helpers.places import bundled_path
from helpers.plain_pictures import plain_pictures
from numpy.typing import NDArray

Image = NDArray[np.uint8]

REFUSED: Final = 2
ARM: Final = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
VALUES: Final = (0.1, -0.2, 0.12, 0.3, -0.5, 0.4)
DEMO: Final = bundled_path("demo")
BEGIN: Final = 1_700_000_000_000_000_000
STEP: Final = 33_000_000

CAMERA: Final[dict[str, Any]] = {
    "width": 64,
    "height": 48,
    "distortion_model": "plumb_bob",
    "D": [0.0] * 5,
    "K": [70.0, 0, 32, 0, 70.0, 24, 0, 0, 1],
    "R": [1.0, 0, 0, 0, 1, 0, 0, 0, 1],
    "P": [70.0, 0, 32, 0, 0, 70.0, 24, 0, 0, 0, 1, 0],
}


@dataclass(frozen=True)
class LabCase:
    """Files of a laboratory: a name, the function that writes them, what is said of them, and right exit codes."""

    name: str
    write: Callable[[Path], Sequence[str]]
    says: str
    codes: tuple[int, ...] = (0, 3)


# files


def _text(name: str, content: str) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a text, which is inspected."""

    def write(folder: Path) -> Sequence[str]:
        (folder / name).write_text(content)
        return ["inspect", name]

    return write


def _state(names: Sequence[str], values: Sequence[float], seconds: int = 100) -> str:
    """Return a JointState as YAML."""
    message = {"header": {"stamp": {"sec": seconds, "nanosec": 0}}, "name": list(names), "position": list(values)}
    return yaml.safe_dump(message) + "---\n"


def _of_arm(arm: str, separator: str = "_outer_") -> list[str]:
    """Return the names of an arm's joints with its prefix."""
    return [f"{arm}{separator}{joint}" for joint in ARM]


def _session(folder: Path, frames: Sequence[str], joints: str | None, *, camera: str | None = None) -> Path:
    """Write a session with small masks; returns its folder."""
    session = folder / "session"
    (session / "masks").mkdir(parents=True)
    for name in frames:
        cv2.imwrite(str(session / "masks" / f"{name}.png"), _small_mask())
    (session / "camera.yaml").write_text(yaml.safe_dump(CAMERA) if camera is None else camera)
    if joints is not None:
        (session / "joints.csv").write_text(joints)
    return session


def _small_mask() -> Image:
    """Return a mask of the camera's size."""
    mask = np.zeros((48, 64), np.uint8)
    mask[10:30, 20:40] = 255
    return mask


def _rows(labels: Sequence[object], first: str = "frame") -> str:
    """Return a table of readings with a row for each label."""
    rows = [",".join(map(str, (label, *VALUES))) for label in labels]
    return "\n".join([",".join((first, *ARM)), *rows, ""])


def _inspected(
    frames: Sequence[str], joints: str | None, *more: str, files: dict[str, str] | None = None
) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a session, which is inspected."""

    def write(folder: Path) -> Sequence[str]:
        session = _session(folder, frames, joints)
        for name, content in (files or {}).items():
            (session / name).write_text(content)
        return ["inspect", "session", *more]

    return write


def _tracked(frames: Sequence[str], joints: str) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a session, which is to be followed."""

    def write(folder: Path) -> Sequence[str]:
        _session(folder, frames, joints)
        return ["track", "session", "--out", "tracks", "--no-video", "--no-page"]

    return write


def _recorded_before(folder: Path) -> Sequence[str]:
    """Write a session whose first image is of a time before the readings, which is to be followed."""
    session = _session(folder, ["0", "1", "2"], _rows([f"{10 + 0.02 * k:.2f}" for k in range(9)], "time"))
    (session / "images.csv").write_text("frame,time\n0,9.0\n1,10.05\n2,10.1\n")
    return ["track", "session", "--out", "tracks", "--no-video", "--no-page"]


def _masked(pixels: Callable[[Image], Image], *more: str) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a mask made of the demo's, of which the pose is estimated."""

    def write(folder: Path) -> Sequence[str]:
        made = pixels(np.asarray(cv2.imread(str(DEMO / "masks" / "0001.png"), cv2.IMREAD_GRAYSCALE), np.uint8))
        cv2.imwrite(str(folder / "m.png"), made)
        camera, joints = (str(DEMO / file) for file in ("camera.yaml", "joints.csv"))
        return ["estimate", "--mask", "m.png", "--camera", camera, "--joints", joints, "--frame", "0001", *more]

    return write


def _coloured(mask: Image) -> Image:
    return np.where(mask[..., None] > 127, np.array([0, 255, 0]), np.array([10, 10, 10])).astype(np.uint8)


def _stereo_session(unit: float) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a session of two cameras, 58 of a unit apart in metres."""

    def write(folder: Path) -> Sequence[str]:
        session = _session(folder, ["0"], None)
        (session / "camera.yaml").unlink()
        for side in ("left", "right"):
            (session / "masks" / side).mkdir()
            cv2.imwrite(str(session / "masks" / side / "0.png"), _small_mask())
        (session / "masks" / "0.png").unlink()
        eyes = {f"K{k}": [*CAMERA["K"]] for k in (1, 2)} | {f"D{k}": [0.0] * 5 for k in (1, 2)}
        pose = {"R": np.eye(3).ravel().tolist(), "T": [-58 * unit, 0.0, 0.0]}
        (session / "camera.yaml").write_text(yaml.safe_dump({"image_size": [64, 48], **eyes, **pose}))
        return ["inspect", "session"]

    return write


# recordings


@dataclass(frozen=True)
class _Message:
    topic: str
    kind: str
    time: int
    fields: dict[str, Any]
    stamp: int | None = None


def _image(number: int, encoding: str = "mono8") -> _Message:
    pixels = np.random.default_rng(number).integers(0, 256, (48, 64 * (2 if encoding in ("uyvy", "yuyv") else 1)))
    fields = {
        "height": 48,
        "width": 64,
        "encoding": encoding,
        "is_bigendian": 0,
        "step": pixels.shape[1],
        "data": pixels.astype(np.uint8).ravel(),
    }
    return _Message("/eye/image_raw", "Image", BEGIN + number * STEP, fields)


def _info(**changes: Any) -> _Message:
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    arrays = {name.lower(): np.array(CAMERA[name], float) for name in "DKRP"}
    fields = {
        "height": 48,
        "width": 64,
        "distortion_model": "plumb_bob",
        **arrays,
        "binning_x": 0,
        "binning_y": 0,
        "roi": region,
    }
    return _Message("/eye/camera_info", "CameraInfo", BEGIN, {**fields, **changes})


def _joints(number: int, names: Sequence[str] = ARM, topic: str = "/PSM1/measured_js") -> _Message:
    values = np.resize(np.array(VALUES), len(names)) + 0.001 * number
    empty = np.zeros(0)
    fields = {"name": list(names), "position": values, "velocity": empty, "effort": empty}
    return _Message(topic, "JointState", BEGIN + number * STEP, fields)


def _recorded(images: int = 6, encoding: str = "mono8") -> list[_Message]:
    return [_info(), *(_image(k, encoding) for k in range(images)), *(_joints(k) for k in range(-1, images + 1))]


def _bag(
    messages: Sequence[_Message],
    *more: str,
    metadata: Callable[[str], str | None] = lambda text: text,
    command: str = "import",
) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a ROS 2 recording, which is imported, with its metadata changed or removed."""

    def write(folder: Path) -> Sequence[str]:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        types = store.types
        with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics: dict[str, Any] = {}
            for own in sorted(messages, key=lambda message: message.time):
                name = f"sensor_msgs/msg/{own.kind}"
                if own.topic not in topics:
                    topics[own.topic] = writer.add_connection(own.topic, name, typestore=store)
                at = own.time if own.stamp is None else own.stamp
                time = types["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
                header = types["std_msgs/msg/Header"](stamp=time, frame_id="eye")
                fields = dict(own.fields)
                if own.kind == "CameraInfo":
                    fields["roi"] = types["sensor_msgs/msg/RegionOfInterest"](**fields["roi"])
                writer.write(
                    topics[own.topic], own.time, store.serialize_cdr(types[name](header=header, **fields), name)
                )
        path = folder / "bag" / "metadata.yaml"
        changed = metadata(path.read_text())
        path.unlink()
        if changed is not None:
            path.write_text(changed)
        return [command, "bag", *(() if command == "inspect" else ("--out", "session")), *more]

    return write


def _stamped(messages: Sequence[_Message], kind: str, stamp: Callable[[_Message], int]) -> list[_Message]:
    """Return messages with other times in the headers of those of a kind."""
    return [replace(own, stamp=stamp(own)) if own.kind == kind else own for own in messages]


def _video(size: tuple[int, int], *more: str) -> Callable[[Path], Sequence[str]]:
    """Return a function that writes a video, which is imported."""

    def write(folder: Path) -> Sequence[str]:
        writer = cv2.VideoWriter(str(folder / "v.avi"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, size)
        for k in range(3):
            writer.write(np.random.default_rng(k).integers(0, 256, (size[1], size[0], 3)).astype(np.uint8))
        writer.release()
        (folder / "camera.yaml").write_text(yaml.safe_dump(CAMERA))
        (folder / "joints.csv").write_text(_rows([0, 0.04, 0.08, 0.12], "time"))
        return ["import", "v.avi", "--camera", "camera.yaml", "--joints", "joints.csv", "--out", "session", *more]

    return write


_COMMENTED = "# Topic: /x/measured_js\n# Type: sensor_msgs/JointState\ntimestamp,name.0,position.0,name.1,position.1\n"
_ENDOVIS = (
    "Width: 64 // width\nHeight:\t48\nCamera-0-F: 70.5 70.4 // left\nCamera-0-C: 31 23\nCamera-0-K: -0.001 0 0 0 0\n"
    "Camera-1-F: 70 70\nCamera-1-C: 30 23\nCamera-1-K: 0 0 0 0 0\nExtrinsic-Omega: 0 0 0\nExtrinsic-T: -4.3 0 0\n"
)
_TWO_ARMS = _of_arm("PSM1") + _of_arm("PSM2")
_BOTH = (*VALUES, *[0.1] * 6)

_CELLS = ",".join(map(str, VALUES))
_MATRIX = [[70.0, 0, 32], [0, 71.0, 24], [0, 0, 1]]


def _masks_of_an_arm(folder: Path) -> Sequence[str]:
    """Write a session whose masks are in a folder of the arm, which is inspected."""
    masks = _session(folder, ["0"], _rows([0])) / "masks"
    (masks / "PSM1").mkdir()
    (masks / "0.png").rename(masks / "PSM1" / "0.png")
    return ["inspect", "session"]


def _masks_of_two_arms(folder: Path) -> Sequence[str]:
    """Write a session whose masks are in folders of two arms, which is inspected."""
    words = _masks_of_an_arm(folder)
    shutil.copytree(folder / "session" / "masks" / "PSM1", folder / "session" / "masks" / "PSM2")
    return words


CASES: Final = (
    # readings of several arms
    LabCase(
        "arm and endoscope", _text("js.yaml", _state(_TWO_ARMS[:6] + _of_arm("ECM")[:4], _BOTH[:10])), r"yaw 5\.73 deg"
    ),
    LabCase("slashes", _text("js.yaml", _state(_of_arm("PSM1", "/"), VALUES)), r"wrist_yaw 22\.92 deg"),
    LabCase(
        "two arms, data_collection",
        _text("j.csv", _COMMENTED + "1755000000000000000,PSM1_yaw,0.1,PSM2_yaw,0.2\n"),
        "PSM1, PSM2",
        (REFUSED,),
    ),
    LabCase(
        "two arms, one asked for",
        _inspected(
            ["0", "1"],
            f"frame,{','.join(_TWO_ARMS)}\n0,{','.join(map(str, _BOTH))}\n",
            files={"session.toml": '[[tool]]\narm = "PSM2"\n'},
        ),
        "readings 1",
    ),
    # messages without readings
    LabCase("only empty messages", _text("js.yaml", _state([], [])), "without positions", (REFUSED,)),
    LabCase(
        "names without positions",
        _text("js.yaml", _state(ARM, []) + _state(ARM, VALUES, 101)),
        "1 message without positions",
    ),
    LabCase(
        "a row without positions",
        _text("j.csv", _COMMENTED + "1,,,,\n2,yaw,0.1,pitch,0.2\n"),
        "1 message without positions",
    ),
    # tables
    LabCase("tabs", _text("j.csv", "time\tyaw\tpitch\n0.5\t0.1\t-0.2\n"), r"yaw 5\.73 deg"),
    LabCase("no header", _text("j.csv", "0.1,0.2,0.1,0.3,0.1,0.2\n0.1,0.2,0.1,0.3,0.1,0.2\n"), "--columns", (REFUSED,)),
    LabCase("no header, blanks", _text("j.csv", "1e-1 2e-1 1e-1 3e-1 1e-1 2e-1\n"), "--columns", (REFUSED,)),
    LabCase(
        "no header, named columns",
        _inspected(
            ["0", "1"],
            "0.1,0.2,0.1,0.3,0.1,0.2\n" * 2,
            files={"session.toml": f'[[tool]]\narm = "PSM1"\ncolumns = {json.dumps(ARM)}\n'},
        ),
        "readings 2",
    ),
    LabCase(
        "timestamp,outer_yaw",
        _text("j.csv", "timestamp,outer_yaw\n1755000000.5,0.1\n"),
        r"yaw 5\.73 deg.*times from 1755000000\.500",
    ),
    LabCase("relative milliseconds", _text("j.csv", _rows([33 * k for k in range(20)], "time")), "time_ms", (REFUSED,)),
    LabCase(
        "named milliseconds",
        _text("j.csv", _rows([33 * k for k in range(20)], "time_ms")),
        r"times from 0\.000 to 0\.627 s",
    ),
    LabCase("two columns of times", _text("j.csv", "timestamp,stamp,yaw\n1,2,0.1\n"), "one called time", (REFUSED,)),
    LabCase(
        "PlotJuggler",
        _text(
            "j.csv",
            "__time,"
            + ",".join(f"/PSM1/measured_js/{joint}/{kind}" for kind in ("position", "velocity") for joint in ARM)
            + f"\n1700000000.5,{_CELLS},{_CELLS}\n",
        ),
        r"yaw 5\.73 deg.*wrist_yaw 22\.92 deg.*times from 1700000000\.500",
    ),
    LabCase("dates", _text("j.csv", "time,yaw\n2026-01-01T12:00:00.123456789Z,0.1\n"), r"times from 1767268800\.123"),
    LabCase("dates without a zone", _text("j.csv", "timestamp,yaw\n2026-01-01 12:00:00.5,0.1\n"), r"1767268800\.500"),
    LabCase(
        "degrees, mm", _text("j.csv", "time,yaw_deg,insertion_mm\n0,5.7,120\n"), r"yaw 5\.70 deg.*insertion 120\.00 mm"
    ),
    LabCase(
        "units in brackets",
        _text("j.csv", "time [ms],yaw [deg],pitch (rad)\n500,5.7,0.1\n"),
        r"5\.70 .*5\.73.*0\.500 s",
    ),
    LabCase("yaw in mm", _text("j.csv", "time,yaw_mm\n0,5.7\n"), "unknown joint", (REFUSED,)),
    LabCase("seconds and nanoseconds", _text("j.csv", "sec,nanosec,yaw\n1700000000,5000000,0.1\n"), r"1700000000\.005"),
    LabCase("a comma at the ends", _text("j.csv", "time,yaw,\n0,0.1,\n"), r"yaw 5\.73 deg"),
    LabCase(
        "pandas with files",
        _inspected(
            ["0001", "0002"], f"Unnamed: 0,filename,{','.join(ARM)}\n0,images/0001.png,{_CELLS}\n1,0002.png,{_CELLS}\n"
        ),
        "readings 2",
    ),
    LabCase(
        "names that end in _joint",
        _text("js.yaml", _state([f"psm1_{j}_joint" for j in ARM], VALUES)),
        r"wrist_yaw 22\.92",
    ),
    # names and numbers of frames
    LabCase("masks in a folder of the arm", _masks_of_an_arm, "masks 1, images 0, readings 1"),
    LabCase("masks in folders of two arms", _masks_of_two_arms, r'masks = "masks/PSM1"', (REFUSED,)),
    LabCase(
        "names that do not meet",
        _inspected([f"{k:05d}" for k in range(3)], _rows(range(1000, 1009))),
        "none of 9 rows.*--frame-offset",
        (REFUSED,),
    ),
    LabCase(
        "every fifth image",
        _inspected([str(k) for k in range(3)], _rows(range(15))),
        "rows and frames differ in number.*--frame-step",
    ),
    LabCase("no joints.csv", _inspected(["0"], None), "readings 0.*readings: none"),
    # times
    LabCase(
        "whole seconds",
        _tracked([str(k) for k in range(6)], "frame,time,yaw\n" + "".join(f"{k},{k // 3},0.1\n" for k in range(6))),
        r"track\.frames_a_second",
        (REFUSED,),
    ),
    LabCase("images from before the readings", _recorded_before, "3 frames: "),
    # cameras
    LabCase("EndoVis", _text("c.txt", _ENDOVIS), r"EndoVis.*focal lengths 70\.500 and 70\.400"),
    LabCase("nested", _text("c.yaml", yaml.safe_dump({"endoscope": {"left_eye": CAMERA}})), "64 x 48 px"),
    LabCase(
        "focal length in mm",
        _text("c.yaml", yaml.safe_dump({**CAMERA, "K": [4.5, 0, 32, 0, 4.5, 24, 0, 0, 1]})),
        "millimetres",
        (REFUSED,),
    ),
    LabCase(
        "size as OpenCV's and as NumPy's",
        _text("c.json", json.dumps({"cameraMatrix": _MATRIX, "distCoeffs": [0.0] * 5, "imageSize": [48, 64]})),
        "64 x 48 px",
    ),
    LabCase(
        "RealSense",
        _text(
            "c.json",
            json.dumps(
                {"width": 64, "height": 48, "fx": 70.0, "fy": 71.0, "ppx": 32.0, "ppy": 24.0, "coeffs": [0.0] * 5}
            ),
        ),
        "64 x 48 px",
    ),
    LabCase("K of zeros", _text("c.yaml", yaml.safe_dump({**CAMERA, "K": [0.0] * 9})), "K is zero.*rectified"),
    LabCase("two external cameras, mm", _stereo_session(1.0), "58 mm apart"),
    LabCase("two external cameras, m", _stereo_session(1e-3), "58 mm apart"),
    LabCase("eyes in one place", _stereo_session(1e-6), "expected 0.0005 to 0.5 m", (REFUSED,)),
    # masks
    LabCase("colours, by value", _masked(_coloured, "--label", "1"), "#00ff00", (REFUSED,)),
    LabCase("inverted", _masked(lambda m: 255 - m), "inverted.*--label 0", (REFUSED,)),
    # recordings
    LabCase(
        "stamps of pairs",
        _bag(_stamped(_recorded(8), "Image", lambda own: BEGIN + (own.time - BEGIN) // STEP // 2 * 2 * STEP)),
        "do not advance",
    ),
    LabCase(
        "one stamp twice",
        _bag(_stamped(_recorded(8), "Image", lambda own: own.time - STEP * (own.time == BEGIN + 3 * STEP))),
        "1 images have the time",
    ),
    LabCase("no metadata", _bag(_recorded(), metadata=lambda _: None), "6 frames of 6"),
    LabCase("mono16", _bag(_recorded(encoding="mono16")), "image_proc", (REFUSED,)),
    LabCase(
        "unknown lens",
        _bag([_info(distortion_model="wavy"), *_recorded()[1:]]),
        "/eye/camera_info: distortion_model",
        (REFUSED,),
    ),
    LabCase("readings only", _bag([own for own in _recorded() if own.kind == "JointState"]), "images: none"),
    LabCase("topics", _bag(_recorded(), command="inspect"), "/eye/image_raw: sensor_msgs/Image, 6 messages"),
    LabCase(
        "two arms of a recording",
        _bag([*_recorded(), *(_joints(k, topic="/PSM2/measured_js") for k in range(7))]),
        "--arm",
        (REFUSED,),
    ),
    LabCase(
        "two arms in one topic",
        _bag([*_recorded()[:7], *(_joints(k, _TWO_ARMS, "/joint_states") for k in range(-1, 7))], "--arm", "PSM2"),
        "6 frames with readings",
    ),
    # videos
    LabCase("side by side", _video((128, 48), "--side", "right"), "3 frames of 3 images, 64 x 48"),
    LabCase("squeezed", _video((64, 48), "--layout", "squeezed-side-by-side"), "no option here.*ffmpeg", (REFUSED,)),
    LabCase("another aspect", _video((96, 48)), "--layout.*--crop", (REFUSED,)),
    LabCase("a part", _video((96, 64), "--crop", "16,8,64,48"), "3 frames of 3 images, 64 x 48"),
    LabCase("fields", _video((64, 48), "--interlaced", "top"), "no option here.*ffmpeg", (REFUSED,)),
)


@pytest.fixture(scope="module")
def stored_estimates() -> Iterator[None]:
    """Let each estimate be a stored result: these tests are about what is read."""
    result = canned(
        "0000",
        covariance=np.diag([2e-4] * 3 + [0.01] * 6) ** 2,
        expected_error=EXPECTED_ERROR,
    )

    def estimate(*_: Any, frame: str = "", **__: Any) -> Any:
        return replace(result, frame=frame)

    with pytest.MonkeyPatch.context() as patch, plain_pictures():
        patch.setattr("dvrk_cmaes.runs.frame.estimate_views", estimate)
        patch.setattr("dvrk_cmaes.estimation.image_frame.estimate_views", estimate)
        yield


@pytest.mark.usefixtures("stored_estimates")
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_file_is_read_or_refused_with_the_remedy(
    case: LabCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = case.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    ran = run_command(capsys, *command)
    said = ran.err + ran.out
    assert ran.code in case.codes, said
    assert "internal error" not in said
    assert ran.code != REFUSED or len(ran.err.strip().splitlines()) == 1
    assert re.search(case.says, said, re.DOTALL), said
