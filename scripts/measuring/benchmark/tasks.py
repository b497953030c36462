"""Tasks of the benchmark: which worlds and seeds, what a method is given, and where the truth is kept.

A folder of the benchmark has, by seed and world, ``drawn`` sessions and recordings with the truth, and what is
``given`` to methods: the same without the truth, of the task ``images`` also without masks. Nothing else is to be read.
"""

from __future__ import annotations

import csv
import hashlib
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from worlds.drawing import picture
from worlds.folders import USUAL_PIXELS, Folder, add_right_eye, drawn_folder
from worlds.motion import Kind, draw_motion, frame_times
from worlds.table import World, worlds

from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.markers import place_markers, read_marker_table
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.atomic import write_text
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.scene import NEAREST, Scene

Float64 = NDArray[np.float64]
TaskName = Literal["frame", "session", "eyes", "base", "masks", "images"]

INSTRUMENT: Final = "lnd"
"""The bundled instrument, which is in all worlds."""
SEED: Final = 1001
"""The published seed. The program's settings were chosen on worlds of other seeds."""
KEPT: Final = (
    "1e1c9777e7c886f6d010ba4ea27ec358edbbc9580709535e7984ff4d430d845b",
    "aebc23dd4055343becbf9a9f81c1c76cff8e1211596e1fe75260a4303829eca8",
    "035c284731b13b3b2bc742c6baa6ffcab17b4f8fb03ccca899ef732d521bf8cc",
)
"""SHA-256 of the seeds that are kept, written in decimal digits; they are published with the next release."""
FRAMES: Final[Mapping[Kind, int]] = {"session": 6, "recording": 30}
"""Numbers of frames of each session and recording."""
BASE: Final = "base"
"""What a row of the task base has as its frame."""

_LARGEST_IMAGE: Final = 1920 * 1080  # px
_LARGEST_TOLD: Final = 2**32
_BURIED: Final = 2.5e-3  # m, by which the surface may be nearer than a marker that is seen; the meshes are not the same


@dataclass(frozen=True)
class Task:
    """What is asked: ``kind`` of folder that is given, what of it is not, and whether of both eyes."""

    kind: Kind
    asked: str
    without: tuple[str, ...] = ()
    eyes: bool = False

    @property
    def folder(self) -> str:
        """Name of the given folder."""
        return f"{self.kind}-eyes" if self.eyes else f"{self.kind}-images" if self.without else self.kind


TASKS: Final[Mapping[TaskName, Task]] = {
    "frame": Task("session", "pose and joints of each frame, from its own mask or image and readings alone"),
    "session": Task("session", "the same from all frames of a session together"),
    "eyes": Task("session", "the same from both eyes; poses are those in the left one", eyes=True),
    "base": Task("session", "camera_from_base of a session (the hand-eye transform of a camera that stands)"),
    "masks": Task("recording", "pose and joints in every frame of a recording, by masks and readings"),
    "images": Task(
        "recording",
        "the same by images, without masks, and a box around the instrument in the first one",
        ("masks", "ignored", "markers.csv"),
    ),
}


@dataclass(frozen=True)
class Given:
    """What a method is given of a task, and the drawn folder with the truth, which only the scorer reads."""

    task: TaskName
    given: Folder
    drawn: Folder

    @property
    def world(self) -> World:
        """The world."""
        return self.drawn.world

    @property
    def frames(self) -> list[str]:
        """Names of the rows that are asked for."""
        return [BASE] if self.task == "base" else self.drawn.names


def digest(seed: str) -> str:
    """Return the SHA-256 of a seed in decimal digits."""
    return hashlib.sha256(seed.encode()).hexdigest()


def set_name(seed: int) -> str:
    """Return the name of a seed's folders, which does not tell a seed that is kept."""
    return f"seed{seed}" if seed < _LARGEST_TOLD else f"kept-{digest(str(seed))[:12]}"


@cache
def table() -> dict[int, World]:
    """Return the worlds of the table with the bundled instrument by number, those with the largest images left out.

    One of 3840 x 2160 px takes as long as six others.
    """
    return {world.number: world for world in worlds() if np.prod(world.size) <= _LARGEST_IMAGE}


def given_task(
    parent: Path, task: TaskName, world: World, seed: int = SEED, counts: Mapping[Kind, int] = FRAMES
) -> Given:
    """Draw what a task needs of a world, unless it is there, and return what is given.

    Raises
    ------
    DvrkCmaesError
        No motion or readings were found; a file cannot be written.
    """
    asked, place = TASKS[task], Path(set_name(seed)) / f"{world.number:03d}"
    drawn = drawn_folder(parent / "drawn" / place, world, seed, asked.kind, counts[asked.kind])
    if not (drawn.path / "markers.csv").exists():
        write_text(drawn.path / "markers.csv", _detected_markers(drawn, seed))
    path = parent / "given" / place / f"{asked.folder}-{drawn.frames}"
    stamp = path.stat().st_mtime if path.exists() else 0.0
    if stamp < (drawn.path / "world.json").stat().st_mtime:
        shutil.rmtree(path, ignore_errors=True)
        hidden = shutil.ignore_patterns("golden.json", "world.json", *asked.without)
        shutil.copytree(drawn.path, path, ignore=hidden, copy_function=shutil.copyfile)
        if asked.eyes:
            add_right_eye(drawn, seed, path)
        if "masks" in asked.without:
            write_text(path / "boxes.csv", _first_box(drawn))
        os.utime(path)
    return Given(task, replace(drawn, path=path), drawn)


def _first_box(drawn: Folder) -> str:
    """Return boxes.csv: the box around the mask in the first image, which tells the instrument that is meant."""
    name = drawn.names[0]
    mask = read_mask(drawn.path / "masks" / f"{name}.png", label=1 if drawn.world.tools > 1 else None)
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    row = [name, *map(str, (left, top, left + width - 1, top + height - 1))]
    return csv_text(("frame", "x0", "y0", "x1", "y1"), [row])


def _detected_markers(drawn: Folder, seed: int) -> str:
    """Return markers.csv: the painted markers of the instrument that are seen, with a detector's noise.

    All that are in the picture and not hidden are detected, which is kind to methods with markers.
    """
    world = drawn.world
    rng = np.random.default_rng([seed, world.number, 7, drawn.kind == "session"])
    noise = LEVELS[world.level].marker_px * float(np.sqrt(np.prod(world.size) / USUAL_PIXELS))
    known, inside = read_marker_table(bundled_path("markers", "lnd.json")), picture(world)
    times = frame_times(world, drawn.kind, drawn.frames)
    placed_at = [draw_motion(world, seed, place).placed(times) for place in range(world.tools)]
    rows = []
    for number, name in enumerate(drawn.names):
        tools = [each[number] for each in placed_at]
        places = place_markers(tools[0].instrument, tools[0].values, known)
        points = apply(tools[0].camera_from_root, np.array([*places.values()]))
        _, depth = Scene(tools).hits((points / points[:, 2:]).astype(np.float32))
        seen = (depth > points[:, 2] - _BURIED) | (depth <= NEAREST)
        pixels = world.camera.project(points)
        for marker, pixel, shown in zip(places, pixels, seen, strict=True):
            detected = pixel + noise * rng.standard_normal(2)
            column, row = np.rint(pixel).astype(int)
            within = 0 <= column < world.size[0] and 0 <= row < world.size[1] and bool(inside[row, column])
            if shown and within:
                rows.append([name, marker, *(f"{value:.2f}" for value in detected)])
    return csv_text(("frame", "marker", "u", "v"), rows)


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings at the times of F frames: the outer joints (F, 4) and the instrument's (F, J)."""

    outer: Float64
    joints: Float64


def readings_of(given: Folder, instrument: Instrument) -> Readings:
    """Return the readings of a given folder, interpolated to the times of its images; lags are not taken out."""
    with (given.path / "joints.csv").open(encoding="utf-8", newline="") as file:
        rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)]
    stamps = [*given.times().values()]
    read = {name: np.interp(stamps, [row["time"] for row in rows], [row[name] for row in rows]) for name in rows[0]}
    outer, joints = (np.stack([read[name] for name in names], 1) for names in (OUTER_JOINTS, instrument.joint_names))
    return Readings(outer, joints)
