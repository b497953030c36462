"""Inputs of every command in every format, and seeded ways to damage them."""

from __future__ import annotations

import functools
import io
import json
import os
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from dvrk_cmaes.cli.options import InstrumentOptions
from helpers.canned_results import canned
from helpers.instrument_files import TETRA_OBJ, mesh_link, write_urdf
from helpers.made_recordings import good, write_bag, write_video
from helpers.places import bundled_path

DEMO = bundled_path("demo")
MASK, IMAGE, CAMERA, JOINTS = (DEMO / p for p in ("masks/0000.png", "images/0000.jpg", "camera.yaml", "joints.csv"))

Arguments = list[object]


@dataclass(frozen=True)
class Input:
    """A file that a command reads.

    ``place`` makes the files around it and gives its path, ``arguments`` give the command line. ``cuts`` are the shares
    that are left of a truncated file, for formats in which truncation is detectable. ``optional``: it may be missing.
    """

    name: str
    good: Callable[[], bytes]
    place: Callable[[Path], Path]
    arguments: Callable[[Path], Arguments]
    cuts: tuple[float, ...] = ()
    optional: bool = False


def frame(**changes: object) -> Arguments:
    """Give the arguments of ``estimate`` for a good frame, with some replaced."""
    options: dict[str, object] = {"mask": MASK, "camera": CAMERA, "joints": JOINTS, "frame": "0000", **changes}
    return ["estimate", *(part for key, value in options.items() for part in (f"--{key}", value))]


@contextmanager
def stopped_after_reading(frame: Callable[..., None], session: Callable[..., None]) -> Iterator[None]:
    """Call these with the inputs read by ``estimate`` and ``batch`` instead of the work; load the instrument once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvrk_cmaes.runs.frame.estimate_views", frame)
        patch.setattr("dvrk_cmaes.runs.batch.run_batch", session)
        patch.setattr(InstrumentOptions, "load", functools.cache(InstrumentOptions.load))
        yield


# good files


def _encoded(path: Path, extension: str) -> bytes:
    return cv2.imencode(extension, cv2.imread(str(path), cv2.IMREAD_UNCHANGED))[1].tobytes()


def _opencv(extension: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"stereo{extension}"
        file = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
        for side in "12":
            file.write(f"K{side}", np.array([[1042.6, 0, 326.3], [0, 1042.6, 235.1], [0, 0, 1]]))
            file.write(f"D{side}", np.zeros((1, 5)))
        file.write("Image_Dimensions", np.array([[640.0, 480.0]]))
        file.release()
        return path.read_bytes()


def _dump(letters: str) -> bytes:
    k, d, p = letters
    return (
        f"header:\n  stamp: {{sec: 1, nanosec: 2}}\nheight: 480\nwidth: 640\ndistortion_model: plumb_bob\n"
        f"{d}: [0, 0, 0, 0, 0]\n{k}: [1042.6, 0, 326.3, 0, 1042.6, 235.1, 0, 0, 1]\n"
        f"{p}: [1042.6, 0, 326.3, 0, 0, 1042.6, 235.1, 0, 0, 0, 1, 0]\n---\n"
    ).encode()


KALIBR = b"""cam0:
  camera_model: pinhole
  intrinsics: [1042.6, 1042.6, 326.3, 235.1]
  distortion_model: radtan
  distortion_coeffs: [0, 0, 0, 0]
  resolution: [640, 480]
"""
PLAIN = b"intrinsic: [[1042.6, 0, 326.3], [0, 1042.6, 235.1], [0, 0, 1]]\ndistortion: [0, 0, 0, 0, 0]\n"
STATE = b"name: [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw]\nposition: [0.1, 0.2, 0.1, 0.3, 0.8, -0.3]\n---\n"
TOPIC = (
    b"# Topic: /PSM1/jaw/measured_js\n# Type: sensor_msgs/JointState\n"
    b"timestamp,name.0,position.0\n1755000000000000000,jaw,0.5\n"
)
MEASURED = (
    b"traj_index,measured_q1,measured_q2,measured_q3,measured_q4,measured_q5,measured_q6\n"
    b"0.0,0.1,0.2,0.1,0.3,0.8,-0.3\n"
)


def _npy() -> bytes:
    data = io.BytesIO()
    np.save(data, np.array([0.1, 0.2, 0.1, 0.3, 0.8, -0.3]))
    return data.getvalue()


def _mesh(kind: str) -> bytes:
    solid = trimesh.creation.cylinder(radius=0.004, height=0.3, sections=16)
    exported = solid.export(file_type=kind)
    return exported.encode() if isinstance(exported, str) else exported


def _ascii_ply() -> bytes:
    exported: bytes = trimesh.creation.box(extents=(0.01, 0.01, 0.3)).export(file_type="ply", encoding="ascii")
    return exported


@functools.cache
def _recorded(kind: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        if kind == "video":
            return write_video(Path(folder) / "v.avi", 3, code="MJPG").read_bytes()
        bag = write_bag(Path(folder) / "bag", kind, good(2))
        file = bag if bag.is_file() else next(p for p in bag.iterdir() if p.name != "metadata.yaml")
        return file.read_bytes()


@functools.cache
def _metadata() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return (write_bag(Path(folder) / "bag", "mcap", good(2)) / "metadata.yaml").read_bytes()


def _result() -> bytes:
    return json.dumps(canned("0000").to_dict()).encode()


SMALL_CAMERA = b"width: 64\nheight: 48\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n"


# their places, and the command lines


def _beside(name: str) -> Callable[[Path], Path]:
    return lambda folder: folder / name


def _robot(path: Path) -> Arguments:
    return frame(instrument=write_urdf(path.parent / "robot", mesh_link(f"../{path.name}")))


def _session(name: str) -> Callable[[Path], Path]:
    """Copy a session of two frames; gives the path of one of its files."""

    def place(folder: Path) -> Path:
        session = folder / "session"
        for part in ("masks", "images"):
            (session / part).mkdir(parents=True)
        for path in (MASK, DEMO / "masks/0001.png", IMAGE, CAMERA, JOINTS):
            shutil.copy(path, session / path.relative_to(DEMO))
        return session / name

    return place


def _batch(path: Path) -> Arguments:
    return ["batch", path.parent, "--out", path.parent.parent / "out"]


def _bag_folder(name: str) -> Callable[[Path], Path]:
    def place(folder: Path) -> Path:
        bag = folder / "bag"
        bag.mkdir()
        (bag / "metadata.yaml").write_bytes(_metadata())
        (bag / "bag.mcap").write_bytes(_recorded("mcap"))
        return bag / name

    return place


def _importing(path: Path, recording: Path | None = None) -> Arguments:
    return ["import", recording or path, "--out", path.parent.parent / "made"]


def _video(option: str | None) -> Callable[[Path], Arguments]:
    """Give the arguments of an import of a video of which one file is damaged."""

    def arguments(path: Path) -> Arguments:
        beside = path.parent / "beside"
        beside.mkdir()
        (beside / "video.avi").write_bytes(_recorded("video"))
        (beside / "camera").write_bytes(SMALL_CAMERA)
        (beside / "joints").write_text("time,jaw\n0,0.1\n0.04,0.2\n0.08,0.3\n")
        files = {name: path if name == option else beside / name for name in ("camera", "joints")}
        video = path if option is None else beside / "video.avi"
        options = [part for name, file in files.items() for part in (f"--{name}", file)]
        return ["import", video, "--out", path.parent / "made", *options]

    return arguments


_BINARY = (0.02, 0.3, 0.7, 0.95)
_TEXT = (0.1, 0.5)

INPUTS = [
    *(
        Input(
            f"{name} {ext}",
            functools.partial(_encoded, source, f".{ext}"),
            _beside(f"{name}.{ext}"),
            lambda path, name=name: frame(**{name: path}),  # type: ignore[misc]
            _BINARY,
        )
        for name, source in (("mask", MASK), ("image", IMAGE), ("ignore", MASK))
        for ext in ("png", "jpg")
    ),
    *(
        Input(f"camera {kind}", data, _beside(name), lambda path: frame(camera=path), cuts)
        for kind, data, name, cuts in (
            ("ROS", CAMERA.read_bytes, "camera.yaml", _TEXT),
            ("ROS 1 dump", functools.partial(_dump, "KDP"), "camera.yaml", ()),
            ("ROS 2 dump", functools.partial(_dump, "kdp"), "camera.yaml", ()),
            ("OpenCV YAML", functools.partial(_opencv, ".yaml"), "stereo.yaml", _TEXT),
            ("OpenCV XML", functools.partial(_opencv, ".xml"), "stereo.xml", _BINARY),
            ("kalibr", lambda: KALIBR, "camchain.yaml", _TEXT),
        )
    ),
    Input("camera plain", lambda: PLAIN, _session("camera.yaml"), _batch, _TEXT),
    *(
        Input(f"joints {kind}", data, _beside(name), lambda path: frame(joints=path), cuts)
        for kind, data, name, cuts in (
            ("CSV", JOINTS.read_bytes, "joints.csv", ()),
            ("JointState YAML", lambda: STATE, "measured_js.yaml", (0.5,)),
            ("data_collection CSV", lambda: TOPIC, "measured_js.csv", (0.9,)),
            ("measured_q CSV", lambda: MEASURED, "classic.csv", (0.5,)),
            ("NumPy", _npy, "joint_0000.npy", _BINARY),
        )
    ),
    Input("settings", lambda: b"[search]\nsamples = 512\n", _beside("own.toml"), lambda p: frame(config=p), (0.3,)),
    Input(
        "URDF",
        bundled_path("instruments", "lnd", "lnd.urdf").read_bytes,
        lambda folder: Path(shutil.copytree(bundled_path("instruments", "lnd"), folder / "lnd")) / "lnd.urdf",
        lambda path: frame(instrument=path),
        _BINARY,
    ),
    *(
        Input(f"mesh {kind}", data, _beside(f"mesh.{kind.split()[0]}"), _robot, cuts)
        for kind, data, cuts in (
            ("stl", functools.partial(_mesh, "stl"), _BINARY),
            ("obj", lambda: TETRA_OBJ.encode(), (0.1, 0.4)),
            ("dae", functools.partial(_mesh, "dae"), _BINARY),
            ("ply", functools.partial(_mesh, "ply"), _BINARY),
            ("ply ascii", _ascii_ply, (0.02, 0.3)),
        )
    ),
    Input("session's camera", CAMERA.read_bytes, _session("camera.yaml"), _batch, _TEXT),
    Input("session's joints", JOINTS.read_bytes, _session("joints.csv"), _batch, optional=True),
    Input("session's times", lambda: b"frame,time\n0000,1.5\n", _session("images.csv"), _batch, (0.3,), True),
    Input(
        "session's tips",
        lambda: b"frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n0000,1,2,3,4\n",
        _session("keypoints.csv"),
        _batch,
        (0.3,),
        True,
    ),
    Input("session's truth", (DEMO / "golden.json").read_bytes, _session("golden.json"), _batch, _BINARY, True),
    Input("result", _result, _beside("0000.json"), lambda path: ["export", path, "--to", "csv"], _BINARY),
    Input(
        "results' one",
        _result,
        lambda folder: _made(folder / "results" / "frames") / "0000.json",
        lambda path: ["export", path.parent.parent, "--to", "bop"],
        _BINARY,
    ),
    Input("ROS 1 bag", lambda: _recorded("ros1"), lambda f: _made(f / "bag") / "run.bag", _importing, _BINARY),
    Input("ROS 2 sqlite3", lambda: _recorded("sqlite3"), lambda f: _made(f / "bag") / "run.db3", _importing, _BINARY),
    Input("ROS 2 MCAP", lambda: _recorded("mcap"), lambda f: _made(f / "bag") / "run.mcap", _importing, _BINARY),
    Input(
        "ROS 2 metadata",
        _metadata,
        _bag_folder("metadata.yaml"),
        lambda path: _importing(path, path.parent),
        (0.1, 0.5),
        optional=True,
    ),
    Input("video", lambda: _recorded("video"), _beside("video.avi"), _video(None), (0.02,)),
    Input("video's camera", lambda: SMALL_CAMERA, _beside("c.yaml"), _video("camera"), (0.5,)),
    Input(
        "video's joints", lambda: b"time,jaw\n0,0.1\n0.04,0.2\n0.08,0.3\n", _beside("j.csv"), _video("joints"), (0.3,)
    ),
]


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


# damage to any file


def _bytes(make: Callable[[bytes], bytes]) -> Callable[[Path, bytes], None]:
    def damage(path: Path, data: bytes) -> None:
        path.write_bytes(make(data))

    return damage


def _huge(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    os.truncate(path, 2_000_000_000)


def _noise(data: bytes) -> bytes:
    return random.Random(len(data)).randbytes(3000)


def _shuffled(data: bytes) -> bytes:
    mixed = list(data)
    random.Random(len(data)).shuffle(mixed)
    return bytes(mixed)


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"

DAMAGES: dict[str, Callable[[Path, bytes], None]] = {
    "missing": lambda path, data: None,
    "empty": _bytes(lambda data: b""),
    "a folder": lambda path, data: path.mkdir(),
    "a loop of links": lambda path, data: path.symlink_to(path.name),
    "a device": lambda path, data: path.symlink_to("/dev/zero"),
    "a pipe": lambda path, data: os.mkfifo(path),
    "noise": _bytes(_noise),
    "shuffled": _bytes(_shuffled),
    "zeros": _bytes(lambda data: bytes(len(data))),
    "a Git LFS pointer": _bytes(lambda data: LFS),
}
