"""Session folders of worlds: masks with a segmenter's mistakes, images, readings at their own rate, and the truth."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.frames.session_toml import SESSION_FILE, CameraEntry, ToolEntry, session_toml
from dvrk_cmaes.geometry import apply, transform
from dvrk_cmaes.io.atomic import write_image, write_json, write_text
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.synth.levels import LEVELS, Mistakes
from dvrk_cmaes.synth.masks import simulate_segmentation
from dvrk_cmaes.synth.scene import Seen, see
from dvrk_cmaes.synth.truth import Truth
from worlds.drawing import draw_image, picture
from worlds.motion import CLOCK, Kind, Moving, draw_motion, ends_seen, frame_times, lag_of, read_motion
from worlds.table import World

Bool = NDArray[np.bool_]
Float64 = NDArray[np.float64]

WORLD: Final = "world.json"
"""File of a folder's parameters, written last."""
USUAL_PIXELS: Final = 640 * 480
USUAL_SHAFT: Final = 68.0
"""Pixels of the images, and width of the shaft, px, for which the levels' mistakes are stated; they grow with both."""
BASELINE: Final = 0.0053
"""Distance of both eyes, m."""
_BESIDE: Final = 2  # px beside another tool that do not count in `ignored`


@dataclass(frozen=True)
class Folder:
    """A drawn session or recording of a world."""

    path: Path
    world: World
    kind: Kind
    frames: int

    @property
    def names(self) -> list[str]:
        """Names of the frames."""
        return [f"{number:04d}" for number in range(self.frames)]

    @property
    def arm(self) -> str:
        """Name of the arm that is solved."""
        return arms(self.world)[0]

    @property
    def ignored(self) -> Path:
        """Folder of the pixels that a single frame is told not to count: the border and other tools; may be missing."""
        return self.path / ("ignored" if self.world.tools > 1 else "ignore")

    def golden(self) -> dict[str, Any]:
        """Return the truth of all frames by name."""
        frames: dict[str, Any] = json.loads((self.path / "golden.json").read_text(encoding="utf-8"))["frames"]
        return frames

    def camera_from_base(self) -> Float64:
        """Return the true pose (4, 4) of the base of the arm that is solved."""
        return np.array(json.loads((self.path / "golden.json").read_text(encoding="utf-8"))["camera_from_base"])

    def times(self) -> dict[str, float]:
        """Return the times of the images by frame, on the clock of the readings, s."""
        with (self.path / "images.csv").open(encoding="utf-8", newline="") as file:
            return {row["frame"]: float(row["time"]) for row in csv.DictReader(file)}

    def nearest_readings(self, stamp: float) -> dict[str, float]:
        """Return the row of joints.csv, by joint, whose time is nearest to that of an image, s."""
        with (self.path / "joints.csv").open(encoding="utf-8", newline="") as file:
            rows = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)]
        nearest = min(rows, key=lambda row: abs(row["time"] - stamp))
        return {name: value for name, value in nearest.items() if name != "time"}


def arms(world: World) -> tuple[str, ...]:
    """Return the names of the arms of a world, that of the instrument that is solved first."""
    return (("PSM2", "PSM1") if world.side == "left" else ("PSM1", "PSM2"))[: world.tools]


def drawn_folder(parent: Path, world: World, seed: int, kind: Kind, frames: int) -> Folder:
    """Draw a session or a recording into a folder of ``parent`` of its own, unless it is there already.

    Raises
    ------
    DvrkCmaesError
        No motion or readings were found; a file cannot be written.
    """
    folder = Folder(parent / f"{kind}-{frames}", world, kind, frames)
    wanted = {"seed": seed, **world.describe()}
    path = folder.path / WORLD
    if path.exists() and json.loads(path.read_text(encoding="utf-8")) == json.loads(json.dumps(wanted)):
        return folder
    shutil.rmtree(folder.path, ignore_errors=True)
    _draw(folder, seed)
    write_json(path, wanted)
    return folder


def _draw(folder: Folder, seed: int) -> None:
    """Draw all files of a folder but the last."""
    world, out = folder.world, folder.path
    moving = [draw_motion(world, seed, place) for place in range(world.tools)]
    times = frame_times(world, folder.kind, folder.frames)
    lag = lag_of(world, seed)
    stamps = CLOCK + times + lag
    write_camera_info(out / "camera.yaml", world.camera, "world")
    tools = [_tool_entry(world, place, arm) for place, arm in enumerate(arms(world))]
    write_text(out / SESSION_FILE, session_toml(CameraEntry(file=Path("camera.yaml")), tools))
    rows = [[name, f"{stamp:.6f}"] for name, stamp in zip(folder.names, stamps, strict=True)]
    write_text(out / "images.csv", csv_text(("frame", "time"), rows))
    for place, (own, tool) in enumerate(zip(moving, tools, strict=True)):
        read = read_motion(world, seed, own, folder.kind, place)
        table = np.c_[CLOCK + read.times, read.values]
        cells = [[f"{value:.6f}" for value in row] for row in table]
        write_text(out / (tool.joints or Path("joints.csv")), csv_text(("time", *own.names), cells))
    golden = {}
    placed_at = [own.placed(times) for own in moving]
    for number, name in enumerate(folder.names):
        placed = [each[number] for each in placed_at]
        overlap = _draw_frame(folder, seed, number, see(world.camera, placed))
        seen = {"visible": ends_seen(placed, 0), "time": float(stamps[number]), "overlap": overlap}
        golden[name] = _truth(moving[0], placed[0]) | seen
    base = moving[0].camera_from_base.tolist()
    write_json(out / "golden.json", {"camera_from_base": base, "lag": lag, "frames": golden})


def add_right_eye(drawn: Folder, seed: int, out: Path) -> None:
    """Make a copy of a drawn folder one of both eyes: it has the left eye's pictures, and the right one's are drawn.

    The right camera is the same one, ``BASELINE`` to the right of the left one.
    """
    world, right = drawn.world, replace(drawn, path=out / "right")
    right_from_left = transform(np.eye(3), np.array([-BASELINE, 0.0, 0.0]))
    times = frame_times(world, drawn.kind, drawn.frames)
    placed_at = [draw_motion(world, seed, place).placed(times) for place in range(world.tools)]
    for number in range(drawn.frames):
        tools = [each[number] for each in placed_at]
        seen = [replace(tool, camera_from_root=right_from_left @ tool.camera_from_root) for tool in tools]
        _draw_frame(right, seed + 1, number, see(world.camera, seen))
    for own in sorted(right.path.iterdir()):
        (out / own.name).rename(out / "left")
        (out / own.name).mkdir()
        (out / "left").rename(out / own.name / "left")
        own.rename(out / own.name / "right")
    right.path.rmdir()
    (out / "camera.yaml").unlink()
    write_camera_info(out / "left.yaml", world.camera, "left")
    write_camera_info(out / "right.yaml", world.camera, "right", right_from_left=right_from_left)
    entries = [_tool_entry(world, place, arm) for place, arm in enumerate(arms(world))]
    write_text(out / SESSION_FILE, session_toml(CameraEntry(left=Path("left.yaml"), right=Path("right.yaml")), entries))


def _tool_entry(world: World, place: int, arm: str) -> ToolEntry:
    """Return what session.toml says of an instrument."""
    alone = world.tools == 1
    joints = Path("joints.csv" if place == 0 else f"joints_{arm}.csv")
    return ToolEntry(arm, world.arm, world.instrument, label=None if alone else (place + 1,), joints=joints)


def _truth(moving: Moving, placed: Truth) -> dict[str, Any]:
    """Return the truth of a frame as golden.json states it, without the outer joints."""
    joints: Mapping[str, float] = dict(zip(moving.instrument.joint_names, placed.values.tolist(), strict=True))
    ends = apply(placed.camera_from_root, placed.instrument.ends(placed.values))
    return {"T_camera_roll_link": placed.camera_from_root.tolist(), "joints": joints, "tips_camera_m": ends.tolist()}


def _draw_frame(folder: Folder, seed: int, number: int, seen: Seen) -> float:
    """Write the image, the mask and what does not count of a frame; return the overlap of the mask with the truth.

    The overlap is that of the instrument that is solved, intersection over union.
    """
    world, name = folder.world, folder.names[number]
    inside = picture(world)
    rng = np.random.default_rng([seed, world.number, 4, number, folder.kind == "session"])
    exact = [(share > 0.5) & inside for share in seen.coverage]
    masks = [_segmented(world, each, rng, inside) for each in exact]
    if world.tools == 1:
        write_image(folder.path / "masks" / f"{name}.png", masks[0])
    else:
        labels = np.zeros(inside.shape, np.uint8)
        for label, mask in reversed([*enumerate(masks, 1)]):
            labels[mask] = label
        write_image(folder.path / "masks" / f"{name}.png", labels)
        other = cv2.dilate((labels > 1).astype(np.uint8), np.ones((2 * _BESIDE + 1, 2 * _BESIDE + 1), np.uint8)) > 0
        other &= labels != 1
        write_image(folder.path / "ignored" / f"{name}.png", other | ~inside if world.border == "circle" else other)
    if world.border == "circle":
        write_image(folder.path / "ignore" / f"{name}.png", ~inside)
    write_image(folder.path / "images" / f"{name}.jpg", draw_image(world, seed, number, seen), quality=92)
    return float((masks[0] & exact[0]).sum() / max((masks[0] | exact[0]).sum(), 1))


def _segmented(world: World, exact: Bool, rng: np.random.Generator, inside: Bool) -> Bool:
    """Return a mask (H, W) with the level's mistakes."""
    mistakes = LEVELS[world.level].mistakes
    if mistakes is None or not exact.any():
        return exact
    sized = _sized(mistakes, world)
    part = _around(exact, int(3 * sized.lump_radius[1]) + 8)
    made = np.zeros_like(exact)
    made[part] = simulate_segmentation(exact[part], rng, sized).mask
    return np.asarray(made & inside)


def _around(region: Bool, margin: int) -> tuple[slice, slice]:
    """Return the rows and columns of a region (H, W) that is not empty, with a margin, px."""
    left, top, width, height = cv2.boundingRect(region.astype(np.uint8))
    rows = slice(max(top - margin, 0), min(top + height + margin, region.shape[0]))
    return rows, slice(max(left - margin, 0), min(left + width + margin, region.shape[1]))


def _sized(mistakes: Mistakes, world: World) -> Mistakes:
    """Return mistakes that are as large beside the image and the instrument as usual, or smaller beside one of them."""
    factor = min(float(np.sqrt(np.prod(world.size) / USUAL_PIXELS)), world.shaft_px / USUAL_SHAFT)
    smallest, largest = mistakes.lump_radius
    return replace(
        mistakes,
        cell=max(1, round(mistakes.cell * factor)),
        wave=mistakes.wave * factor,
        wavelength=max(4.0, mistakes.wavelength * factor),
        lump_radius=(smallest * factor, largest * factor),
    )
