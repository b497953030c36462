"""Families of inputs for scripts/fuzz.py: a file of each kind that is read, and the command lines that read it."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.cli import main as run_command_line
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.images import read_image, read_mask
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.json_file import write_image, write_json
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.io.video_writer import quiet_ffmpeg
from dvrk_cmaes.results.folder import read_results
from dvrk_cmaes.runs.batch import run_batch
from dvrk_cmaes.runs.frame import ArmInSession
from dvrk_cmaes.runs.pool import Workers
from dvrk_cmaes.silhouette.prepare import prepare

FRAMES = 3
QUICK = """seed = 1
[search]
samples = 64
starts = 1
evaluations = 20
free_share = 0.15
width_px = 80
[refine.outline]
iterations = 4
blur = 1.2
[trust]
largest_base_deg = 10.0
"""
_PRIMITIVE = """<robot name="box">
  <link name="roll_link">
    <visual><origin xyz="0 0 -0.15" rpy="0 0 0"/><geometry><cylinder radius="0.004" length="0.3"/></geometry></visual>
  </link>
  <link name="wrist">
    <visual><geometry><box size="0.006 0.006 0.012"/></geometry></visual>
    <visual><geometry><mesh filename="package://parts/part.dae" scale="0.01 0.01 0.01"/></geometry></visual>
    <visual><geometry><mesh filename="part.stl" scale="0.01 0.01 0.01"/></geometry></visual>
  </link>
  <joint name="wrist_pitch" type="revolute">
    <parent link="roll_link"/><child link="wrist"/><axis xyz="0 1 0"/><origin xyz="0 0 0.001" rpy="0 0 0"/>
    <limit lower="-1.3" upper="1.3" effort="1" velocity="1"/>
  </joint>
</robot>
"""
_TOOL = {
    "DH": {
        "convention": "modified",
        "joints": [
            {"name": "roll", "alpha": 0.0, "A": 0.0, "theta": 0.0, "D": 0.467, "type": "revolute", "offset": 0.0}
            | {"qmin": -4.5, "qmax": 4.5},
            {"name": "wrist_pitch", "alpha": -1.5708, "A": 0.0, "theta": 0.0, "D": 0.0, "type": "revolute"}
            | {"offset": -1.5708, "qmin": -1.3, "qmax": 1.3},
            {"name": "wrist_yaw", "alpha": -1.5708, "A": 0.0091, "theta": 0.0, "D": 0.0, "type": "revolute"}
            | {"offset": -1.5708, "qmin": -1.3, "qmax": 1.3},
        ],
    },
    "jaw": {"qmin": -0.7, "qmax": 1.4},
}
_TEXTURED = """<library_images><image id="i"><init_from>texture.png</init_from></image></library_images>
<library_nodes><node id="n"><instance_geometry url="#geometry0"/></node></library_nodes><library_geometries>"""

Command = list[str]
Kind = Literal["document", "text", "bytes", "options"]


@dataclass(frozen=True)
class Family:
    """Files of one kind.

    ``file`` is its path below the folder of the material; ``commands`` are the command lines that read it, run in that
    folder, of which each try takes one. ``refuses``: every command refuses a file that cannot be read at all.
    """

    name: str
    kind: Kind
    file: str
    commands: tuple[Command, ...]
    refuses: bool = True


_NPY = "joint_0001.npy"
_FRAME = ["estimate", "--frame", "0000", "--config", "quick.toml", "--out", "made"]
_CAMERA, _JOINTS = ["--camera", "session/camera.yaml"], ["--joints", "session/joints.csv"]
_MASK = ["--mask", "session/masks/0000.png"]
_IMAGE = ["--image", "session/images/0000.jpg"]
_ESTIMATE = [*_FRAME, *_MASK, *_CAMERA, *_JOINTS]
_BATCH = ["batch", "session", "--config", "quick.toml", "--workers", "1", "--out"]
_EXPORTS = [["export", "results", "--to", to, "--out", "made"] for to in ("csv", "tf", "bop", "easy-handeye")]
_RESULTS = (*_EXPORTS, ["consistency", "results"], ["inspect", "results"])
_PARTS = [*_FRAME, *_MASK, *_CAMERA, "--joints", "wrist.csv", "--instrument", "robot/box.urdf"]
_ARMS = ["batch", "arms", "--config", "quick.toml", "--workers", "1", "--out", "new"]
_TRACK = ["track", "session", "--config", "quick.toml", "--out", "tracks"]


def _read(file: str, *commands: Command) -> tuple[Command, ...]:
    return (*commands, ["inspect", file], ["inspect", file, "--json"])


FAMILIES: tuple[Family, ...] = (
    Family("mask", "bytes", "session/masks/0000.png", _read("session/masks/0000.png", _ESTIMATE)),
    Family("mask, JPEG", "bytes", "mask.jpg", _read("mask.jpg", [*_FRAME, *_CAMERA, *_JOINTS, "--mask", "mask.jpg"])),
    Family("image", "bytes", "session/images/0000.jpg", _read("session/images/0000.jpg", [*_ESTIMATE, *_IMAGE])),
    Family("camera", "text", "session/camera.yaml", (*_read("session/camera.yaml", _ESTIMATE), [*_BATCH, "new"])),
    Family("camera, OpenCV", "text", "cv.xml", _read("cv.xml", [*_FRAME, *_MASK, *_JOINTS, "--camera", "cv.xml"])),
    Family("readings", "text", "session/joints.csv", (*_read("session/joints.csv", _ESTIMATE), [*_BATCH, "new"])),
    Family("session.toml", "text", "arms/session.toml", (["inspect", "arms"], _ARMS)),
    Family("readings, second arm", "text", "arms/joints_PSM2.csv", (["inspect", "arms"], _ARMS)),
    Family("mask, second arm", "bytes", "arms/masks_PSM2/0001.png", (["inspect", "arms"], _ARMS), refuses=False),
    Family(
        "readings, NumPy",
        "bytes",
        _NPY,
        _read(_NPY, [*_FRAME, *_MASK, *_CAMERA, "--joints", _NPY]),
    ),
    Family("settings", "text", "quick.toml", (_ESTIMATE, [*_BATCH, "new"])),
    Family("URDF", "text", "robot/box.urdf", _read("robot/box.urdf", _PARTS)),
    Family("mesh, DAE", "text", "robot/part.dae", _read("robot/part.dae", _PARTS)),
    Family("mesh, STL", "bytes", "robot/part.stl", _read("robot/part.stl", _PARTS)),
    Family("package", "text", "robot/package.xml", (_PARTS,), refuses=False),
    Family("texture", "bytes", "robot/texture.png", (_PARTS,), refuses=False),
    Family("tool", "document", "tool.json", _read("tool.json", [*_ESTIMATE, "--tool", "tool.json"])),
    Family("result", "document", "results/frames/0000.json", (*_RESULTS, ["inspect", "results/frames/0000.json"])),
    Family("result, resumed", "document", "results/frames/0001.json", ([*_BATCH, "results"],), refuses=False),
    Family("run.json", "document", "results/run.json", ([*_BATCH, "results"],)),
    Family("summary.json", "document", "results/summary.json", _RESULTS, refuses=False),
    Family(
        "session.json",
        "document",
        "session.json",
        _read("session.json", [*_ESTIMATE, "--session", "session.json"], ["export", "session.json", "--to", "tf"]),
    ),
    Family("golden.json", "document", "session/golden.json", (["golden", "check", "session"],), False),
    Family(
        "tracks", "text", "tracks/tracks.jsonl", (["export", "tracks", "--to", "csv", "--out", "made"],), refuses=False
    ),
    Family("track's run.json", "document", "tracks/run.json", (_TRACK,), refuses=False),
    Family(
        "video",
        "bytes",
        "video.avi",
        (["import", "video.avi", *_CAMERA, "--joints", "times.csv", "--out", "made"],),
    ),
    Family("video, by name", "bytes", "video.avi", (["inspect", "video.avi"],), refuses=False),
    Family("options", "options", "", (_ESTIMATE, [*_BATCH, "new"], _TRACK, *_EXPORTS)),
)
OPTIONS = (
    *("--seed", "--threads", "--frame", "--label", "--pick", "--search", "--side", "--arm", "--keypoints"),
    *("--time-limit", "--workers", "--frames", "--scheduler", "--lag", "--every", "--session"),
    *("--instrument", "--tool", "--package-path", "--root-link", "--config", "--camera", "--out"),
)
"""Options that are added with odd values to the commands of the family ``options``."""


def write_material(folder: Path) -> None:
    """Write an undamaged file of every family, and what their commands need, to an empty folder."""
    (folder / "quick.toml").write_text(QUICK)
    _write_session(folder / "session")
    session = read_session(folder / "session")
    settings = read_config(folder / "quick.toml", EstimateConfig())
    with ThreadPoolExecutor(1) as executor:
        workers = Workers(executor=executor)
        arm = ArmInSession(session, prepare("lnd"), FrameMethod("classic", settings))
        run_batch(arm, folder / "results", workers=workers)
    _write_calibration(folder / "session.json", folder / "results")
    golden = json.loads(bundled_path("demo", "golden.json").read_text(encoding="utf-8"))
    golden["frames"] = dict(list(golden["frames"].items())[:FRAMES])
    write_json(folder / "session" / "golden.json", golden)
    write_image(folder / "mask.jpg", read_mask(folder / "session/masks/0000.png"))
    np.save(folder / _NPY, np.array([0.1, 0.2, 0.1, 0.3, 0.8, -0.3]))
    (folder / "wrist.csv").write_text("frame,wrist_pitch\n0000,0.1\n")
    (folder / "tool.json").write_text(json.dumps(_TOOL))
    _write_opencv(folder / "cv.xml")
    _write_arms(folder / "arms", folder / "session")
    _write_robot(folder / "robot")
    _write_video(folder / "video.avi", folder / "times.csv")
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        code = run_command_line(_TRACK)
    if code not in (0, 3):
        raise SystemExit(f"fuzz: the material could not be made: track ended with {code}")


def _write_session(folder: Path) -> None:
    """Write three frames of the demo at a quarter of their size."""
    demo = bundled_path("demo")
    for part in ("masks", "images"):
        (folder / part).mkdir(parents=True)
    write_camera_info(folder / "camera.yaml", read_session(demo).camera.scaled(160, 120), "small")
    header, *rows = (demo / "joints.csv").read_text(encoding="utf-8").splitlines()
    (folder / "joints.csv").write_text("\n".join([header, *rows[:FRAMES]]) + "\n")
    for number in range(FRAMES):
        mask = read_mask(demo / "masks" / f"{number:04d}.png").astype(np.uint8) * 255
        image = read_image(demo / "images" / f"{number:04d}.jpg")
        for path, pixels in ((f"masks/{number:04d}.png", mask), (f"images/{number:04d}.jpg", image)):
            small = cv2.resize(pixels, (160, 120), interpolation=cv2.INTER_AREA)
            write_image(folder / path, np.asarray(small, np.uint8))


def _write_arms(folder: Path, session: Path) -> None:
    """Write a session of two arms, of which the second one has the mirrored masks of the first."""
    shutil.copytree(session / "masks", folder / "masks_PSM1")
    (folder / "masks_PSM2").mkdir()
    shutil.copy(session / "camera.yaml", folder / "camera.yaml")
    lines = ['[camera]\nfile = "camera.yaml"']
    for arm in ("PSM1", "PSM2"):
        shutil.copy(session / "joints.csv", folder / f"joints_{arm}.csv")
        lines.append(f'[[tool]]\narm = "{arm}"\nmasks = "masks_{arm}"\njoints = "joints_{arm}.csv"')
    (folder / "session.toml").write_text("\n".join(lines) + "\n")
    for path in sorted((folder / "masks_PSM1").iterdir()):
        write_image(folder / "masks_PSM2" / path.name, np.ascontiguousarray(read_mask(path)[:, ::-1]))


def _write_calibration(path: Path, results: Path) -> None:
    first = next(iter(read_results(results).frames.values()))
    offsets = dict.fromkeys(("insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"), 0.001)
    outer = (
        "yaw",
        "pitch",
        "insertion",
        "roll",
        "wrist_pitch",
        "wrist_yaw",
        "jaw",
        "slack_translation",
        "slack_rotation",
    )
    calibration = SessionCalibration(
        instrument="lnd",
        camera_from_base=np.eye(4) if first.camera_from_base is None else first.camera_from_base,
        offsets=offsets,
        axes=("tx", "ty", "tz", "rx", "ry", "rz", *offsets),
        covariance=np.eye(11) * 1e-6,
        covariance_given_camera=np.eye(11) * 1e-6,
        spreads=dict.fromkeys(outer, 0.01),
        frames=("0000",),
    )
    write_json(path, calibration.to_dict())


def _write_opencv(path: Path) -> None:
    file = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    file.write("K", np.array([[260.6, 0, 80], [0, 260.6, 60], [0, 0, 1]]))
    file.write("D", np.zeros((1, 5)))
    file.write("image_width", 160)
    file.write("image_height", 120)
    file.release()


def _write_robot(folder: Path) -> None:
    import trimesh

    folder.mkdir()
    (folder / "box.urdf").write_text(_PRIMITIVE)
    (folder / "package.xml").write_text("<package><name>parts</name></package>")
    solid = trimesh.creation.box(extents=(0.5, 0.5, 1.0))
    plain = solid.export(file_type="dae").decode()
    (folder / "part.dae").write_text(plain.replace("<library_geometries>", _TEXTURED, 1))
    (folder / "part.stl").write_bytes(solid.export(file_type="stl"))
    cv2.imwrite(str(folder / "texture.png"), np.full((8, 8), 200, np.uint8))


def _write_video(path: Path, times: Path) -> None:
    quiet_ffmpeg()
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (160, 120))  # type: ignore[attr-defined]
    for number in range(FRAMES):
        writer.write(np.full((120, 160, 3), 40 * number, np.uint8))
    writer.release()
    times.write_text("time,jaw\n0,0.1\n0.04,0.2\n0.08,0.3\n")
