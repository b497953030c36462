"""The cases in which the answers of two checkouts are compared: their inputs, and the commands that answer."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import cv2
from measuring.report import SHARED

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import bundled_path

_FRAMES: Final = (SHARED / "frames").resolve()

_ONE: Final = ("--workers", "1")
_PLAIN: Final = ("--no-video", "--no-page")
_EVEN: Final = ("--doubtful-session",)
"""Uses sessions that predict frames badly, too: few frames of hard ones do."""


@dataclass(frozen=True)
class Case:
    """A case: its name, a function that writes its inputs to a folder, and its commands.

    The commands run one after the other in the parent of the inputs' folder ``inputs``, and write beside that. They
    get the option --instrument; with ``bundled`` that of the bundled instrument.
    """

    name: str
    write: Callable[[Path], None]
    commands: tuple[tuple[str, ...], ...]
    bundled: bool = False


def _numbered(count: int, step: int = 1, first: int = 0) -> tuple[str, ...]:
    """Return the names of frames ``0000`` and so on."""
    return tuple(f"{first + k * step:04d}" for k in range(count))


def _session(target: Path, *, source: Path | str, frames: Collection[str] | None = None) -> None:
    """Copy a session, with these of its frames: cameras, readings, masks, images and ignored pixels, no truth."""
    found = _FRAMES / source
    if not found.is_dir():
        raise InputError(f"{found}: expected a session folder, got no folder")
    target.mkdir(parents=True, exist_ok=True)
    for path in sorted(found.rglob("*.*")):
        copy = target / path.relative_to(found)
        if path.suffix == ".yaml" or path.name == "README.md":
            shutil.copy(path, copy)
        elif path.name in ("joints.csv", "keypoints.csv"):
            with path.open(encoding="utf-8", newline="") as lines, copy.open("w", encoding="utf-8", newline="") as out:
                header, *rows = csv.reader(lines)
                csv.writer(out).writerows([header, *(row for row in rows if frames is None or row[0] in frames)])
        elif path.suffix in (".png", ".jpg") and (frames is None or path.stem in frames):
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)


def _one_eye(target: Path, *, source: str, frames: Sequence[str]) -> None:
    """Copy a stereo session, whose last frame lacks the right mask, and the others the left one."""
    _session(target, source=source, frames=frames)
    for frame in frames:
        (target / "masks" / ("right" if frame == frames[-1] else "left") / f"{frame}.png").unlink()


def _both_and_one_eye(target: Path, *, source: str, frames: Sequence[str], seen_by_one: Sequence[str]) -> None:
    """Copy a stereo session to ``both``, and frames of it that lack a mask to ``one``."""
    _session(target / "both", source=source, frames=frames)
    _one_eye(target / "one", source=source, frames=seen_by_one)


def _images(target: Path, *, source: str, frames: int) -> None:
    """Copy a recording with the first images of its video as files, and the mask of the first one."""
    names = _numbered(frames)
    _session(target, source=source, frames=names)
    for mask in (target / "masks").iterdir():
        if mask.stem != names[0]:
            mask.unlink()
    (target / "images").mkdir()
    video = cv2.VideoCapture(str(_FRAMES / source / "video.mp4"))
    for name in names:
        cv2.imwrite(str(target / "images" / f"{name}.png"), video.read()[1])
    video.release()


def _golden(target: Path) -> None:
    """Write the golden cases as a session for each camera, and the case without readings as a session by itself."""
    folder = bundled_path("golden")
    cases = json.loads((folder / "golden.json").read_text(encoding="utf-8"))["cases"]
    cameras: dict[str, list[str]] = {}
    for name, case in cases.items():
        cameras.setdefault(json.dumps([case["camera"], sorted(case["readings"])]), []).append(name)
    for number, names in enumerate(cameras.values()):
        session = target / str(number)
        (session / "masks").mkdir(parents=True)
        (session / "ignore").mkdir()
        given = cases[names[0]]["camera"]
        camera = Camera(**{**given, "distortion": tuple(given["distortion"])})
        write_camera_info(session / "camera.yaml", camera, "endoscope")
        rows = [",".join(["frame", *cases[names[0]]["readings"]])]
        for name in names:
            rows.append(",".join([name, *map(str, cases[name]["readings"].values())]))
            shutil.copy(folder / cases[name]["mask"], session / "masks" / f"{name}.png")
            if cases[name]["ignore"]:
                shutil.copy(folder / cases[name]["ignore"], session / "ignore" / f"{name}.png")
        if cases[names[0]]["readings"]:
            (session / "joints.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def _nothing(target: Path) -> None:
    """Write no inputs."""
    target.mkdir(parents=True)


def _frame(session: str, frame: str, out: str, *options: str) -> tuple[str, ...]:
    """Return the command that estimates a frame of a session."""
    inputs = ("--mask", f"{session}/masks/{frame}.png", "--joints", f"{session}/joints.csv")
    return ("estimate", *inputs, "--camera", f"{session}/camera.yaml", "--out", out, *options)


def _frames(name: str, frames: Sequence[str]) -> Case:
    """Return the case of frames of a session that are solved one by one."""
    return Case(name, partial(_session, source=name, frames=frames), (("batch", "inputs", "--out", "out", *_ONE),))


def _calibration(name: str, frames: Sequence[str], *options: str) -> Case:
    """Return the case of a session that is solved together, and of frames that are solved with it."""
    first = frames[0]
    commands = (
        ("calibrate", "inputs", "--out", "out", *_ONE, *options),
        ("batch", "inputs", "--out", "again", "--session", "out", *_EVEN, "--frames", first, *_ONE),
        _frame("inputs", frames[-1], "one", "--session", "out/session.json", *_EVEN),
    )
    return Case(f"calibrate {name}", partial(_session, source=name, frames=frames), commands)


_DEMO: Final = partial(_session, source=bundled_path("demo"))
_STEREO: Final = "made/stereo-medium"
_REAL_EASY: Final = ("0026", "0030", "0050")
_REAL_MEDIUM: Final = ("0010", "0120", "0150", "0240", "0290", "0330")

CASES: Final = (
    Case("demo", _DEMO, (("batch", "inputs", "--out", "out", *_ONE),), bundled=True),
    Case(
        "methods",
        _DEMO,
        (
            _frame("inputs", "0001", "bobyqa", "--search", "bobyqa"),
            _frame("inputs", "0001", "sbplx", "--search", "sbplx"),
            _frame("inputs", "0001", "seed", "--seed", "1", "--image", "inputs/images/0001.jpg"),
        ),
        bundled=True,
    ),
    Case(
        "golden",
        _golden,
        (
            *(("batch", f"inputs/{k}", "--out", f"out{k}", *_ONE) for k in range(3)),
            (
                *("estimate", "--mask", "inputs/3/masks/no_readings.png", "--camera", "inputs/3/camera.yaml"),
                *("--joints", "none", "--out", "out3"),
            ),
        ),
        bundled=True,
    ),
    _frames("made/clean", _numbered(3)),
    _frames("made/easy", _numbered(2)),
    _frames("made/medium", _numbered(3)),
    _frames("made/hard", _numbered(5)),
    _frames("real/easy", _REAL_EASY),
    _frames("real/medium", _REAL_MEDIUM[:3]),
    _frames(_STEREO, _numbered(4)),
    Case(
        "one eye of two",
        partial(_one_eye, source=_STEREO, frames=_numbered(3)),
        (("batch", "inputs", "--out", "out", *_ONE),),
    ),
    Case(
        "crossing tools",
        _nothing,
        (
            ("synth", "made", "--arms", "2", "--motion", "rcm", "--frames", "4", "--seed", "1", "--no-images"),
            ("batch", "made", "--out", "out", *_ONE),
        ),
    ),
    _calibration("made/easy", _numbered(6)),
    _calibration("made/medium", _numbered(10), "--refine-camera"),
    _calibration("real/medium", _REAL_MEDIUM),
    _calibration("video/hard", _numbered(20, step=15)),
    Case(
        "calibrate stereo",
        partial(_both_and_one_eye, source=_STEREO, frames=_numbered(5), seen_by_one=_numbered(3, first=4)),
        (
            ("calibrate", "inputs/both", "--out", "out", *_ONE),
            ("batch", "inputs/both", "--out", "again", "--session", "out", "--frames", "0000", *_ONE),
            ("batch", "inputs/one", "--out", "one", "--session", "out", *_ONE),
        ),
    ),
    Case(
        "track masks",
        partial(_session, source="video/hard", frames=_numbered(60)),
        (
            ("track", "inputs", "--out", "out", *_PLAIN),
            ("track", "inputs", "--out", "causal", "--causal", "--every", "3", *_PLAIN),
            ("track", "inputs", "--out", "unread", "--joints", "none", "--every", "2", *_PLAIN),
        ),
    ),
    Case(
        "track images",
        partial(_images, source="video/hard", frames=30),
        (
            ("track", "inputs", "--out", "out", "--evidence", "images", *_PLAIN),
            ("track", "inputs", "--out", "either", *_PLAIN),
        ),
    ),
    Case(
        "track stereo",
        _nothing,
        (
            ("synth", "made", "--motion", "video", "--frames", "15", "--stereo", "--seed", "2"),
            ("track", "made", "--out", "masks", "--evidence", "masks", *_PLAIN),
            ("track", "made", "--out", "images", "--evidence", "images", *_PLAIN),
        ),
    ),
    Case(
        "track two arms",
        _nothing,
        (
            ("synth", "made", "--motion", "video", "--level", "easy", "--frames", "12", "--arms", "2", "--no-images"),
            ("track", "made", "--out", "out", "--evidence", "masks", *_PLAIN),
        ),
    ),
)
"""All cases; together they take some two minutes of one core."""
