"""Falsified copies of session folders: what users mistake, masks of something else, wrong readings, moved bases.

A kind changes all frames alike, or each by itself at random. What counts is whether a frame is ok although its tips are
far off, and whether a doubt or a remark says what may be wrong. Masks that are mirrored, or cropped and enlarged, and a
wrong focal length often remain unnoticed in single frames, because another pose explains the mask.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.json_file import write_image, write_json, write_text
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.synth.masks import SLIGHT, simulate_segmentation, tissue_region
from measuring.report import SHARED

Bool = NDArray[np.bool_]
Random = np.random.Generator

_READING_OFF: Final = np.deg2rad(60.0)
_LATE_BY: Final = 2  # frames
_FOREIGN_SHARES: Final = (0.1, 0.5, 0.8)  # of the frames of a session, the places of foreign masks
_URDFS: Final = SHARED / "instruments" / "dvrk_model" / "urdf"


@dataclass(frozen=True, eq=False)
class Copy:
    """A falsified copy: its folder, the original session and another one, and further options of the command."""

    folder: Path
    session: Session
    other: Session
    instrument: Instrument
    options: tuple[str, ...] = ()

    def skeleton(self, name: str) -> Float64:
        """Return the pixels (5, 2) of a frame's root, its last wrist joint, the middle of the tips, and the tips."""
        truth = self.session.truth.frames[name]
        points = self.instrument.skeleton([truth.joints[joint] for joint in self.instrument.joint_names])
        points = np.vstack([np.zeros(3), points[-3], points[-2:].mean(axis=0), points[-2:]])
        return self.session.rig.camera.project(apply(truth.camera_from_root, points))

    def masks(self, change: Callable[[Bool, str], Bool]) -> None:
        """Replace each mask by one that is made of it and the frame's name."""
        for one in self.session.frames:
            assert one.mask is not None
            mask = read_mask(one.mask)
            write_image(self.folder / "masks" / f"{one.name}.png", change(mask, one.name))

    def readings(self, change: Callable[[list[dict[str, str]]], list[dict[str, str]]]) -> None:
        """Replace the rows of joints.csv."""
        path = self.folder / "joints.csv"
        with path.open(encoding="utf-8", newline="") as file:
            rows = change([*csv.DictReader(file)])
        write_text(path, csv_text([*rows[0]], ([*row.values()] for row in rows)))

    def camera(self, change: Callable[[Camera], Camera]) -> None:
        """Replace the camera's file."""
        write_camera_info(self.folder / "camera.yaml", change(self.session.rig.camera), "falsified")

    def draw(self, rng: Random, *, camera: Camera | None = None, size: float = 1.0, wander_m: float = 0.0) -> None:
        """Draw masks and truth anew: by another camera, of a tool larger by a factor, of an arm that wanders (rms)."""
        renderer = Renderer(Body.prepare(self.instrument), camera or self.session.rig.camera, threads=1)
        golden = json.loads((self.folder / "golden.json").read_text(encoding="utf-8"))
        moves = np.cumsum(rng.normal(size=(len(golden["frames"]), 3)), axis=0)
        moves *= wander_m / np.sqrt(((moves - moves.mean(axis=0)) ** 2).sum(axis=1).mean())
        for move, (name, truth) in zip(moves - moves.mean(axis=0), golden["frames"].items(), strict=True):
            pose, joints = (
                np.array(truth["T_camera_roll_link"]),
                [truth["joints"][j] for j in self.instrument.joint_names],
            )
            pose[:3, 3] += move
            truth["T_camera_roll_link"] = pose.tolist()
            truth["tips_camera_m"] = apply(pose, size * self.instrument.ends(joints)).tolist()
            pose[:3, 3] /= size  # the image of a larger tool is that of a nearer one
            exact = renderer.masks(pose[None], np.array([joints]))[0]
            write_image(self.folder / "masks" / f"{name}.png", simulate_segmentation(exact, rng, SLIGHT).mask)
        write_json(self.folder / "golden.json", golden)


@lru_cache(maxsize=4)
def _body(urdf: str) -> Body:
    return Body.prepare(load_instrument(_URDFS / urdf))


def _drawn_by(urdf: str) -> Callable[[Copy, Random], bool | None]:
    """Return the falsification by masks of another instrument in the same pose; needs its URDF in ../shared."""

    def falsify(copy: Copy, rng: Random) -> bool | None:
        if not (_URDFS / urdf).exists():
            return False
        body = _body(urdf)
        renderer = Renderer(body, copy.session.rig.camera, threads=1)

        def drawn(mask: Bool, name: str) -> Bool:
            truth = copy.session.truth.frames[name]
            joints = np.array([[truth.joints[joint] for joint in body.instrument.joint_names]])
            found = renderer.masks(truth.camera_from_root[None], joints)[0]
            return simulate_segmentation(found, rng, SLIGHT).mask if found.any() else found

        copy.masks(drawn)
        return None

    return falsify


def _something_else(mask: Bool, rng: Random) -> Bool:
    """Draw a lump, an ellipse, a polygon or a bar."""
    height, width = mask.shape
    centre, size = rng.uniform([0.2 * width, 0.2 * height], [0.8 * width, 0.8 * height]), rng.uniform(0.1, 0.3) * height
    image, at, turn = np.zeros((height, width), np.uint8), centre.astype(int).tolist(), rng.uniform(0, 2 * np.pi)
    match rng.integers(4):
        case 0:
            return tissue_region((height, width), rng, centre, size)
        case 1:
            axes = (int(size), int(size * rng.uniform(0.3, 0.9)))
            cv2.ellipse(image, at, axes, float(np.degrees(turn)), 0, 360, 1, -1)
        case 2:
            angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(4, 9)))
            reach = size * rng.uniform(0.6, 1.6, len(angles))
            corners = centre + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            cv2.fillPoly(image, [corners.astype(np.int32)], 1)
        case _:
            far = (centre + width * np.array([np.cos(turn), np.sin(turn)])).astype(int).tolist()
            cv2.line(image, at, far, 1, int(size * rng.uniform(0.4, 1.0)))
    return np.asarray(image > 0)


def _half(mask: Bool, rng: Random) -> Bool:
    """Cut a mask in half along a random line through its centroid."""
    v, u = np.nonzero(mask)
    turn, (rows, columns) = rng.uniform(0, 2 * np.pi), np.indices(mask.shape)
    return np.asarray(mask & ((columns - u.mean()) * np.cos(turn) + (rows - v.mean()) * np.sin(turn) > 0))


def _enlarged(mask: Bool, rng: Random, share: float | None = None) -> Bool:
    """Crop a mask, at a random place or the upper left corner, and enlarge it to the image's size."""
    (height, width), (across, down) = mask.shape, rng.uniform(size=2)
    part = rng.uniform(0.65, 0.85) if share is None else share
    h, w = round(part * height), round(part * width)
    top, left = (0, 0) if share else (int(down * (height - h)), int(across * (width - w)))
    cut = mask[top : top + h, left : left + w].astype(np.float32)
    return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5)


def _masks(change: Callable[[Bool, Random], Bool]) -> Callable[[Copy, Random], bool | None]:
    return lambda copy, rng: copy.masks(lambda mask, _: change(mask, rng))


def _two_tools(copy: Copy, rng: Random) -> None:
    """Add the mask of another frame to each."""
    known = [read_mask(one.mask) for one in copy.session.frames if one.mask is not None]
    shift, places = int(rng.integers(1, max(len(known), 2))), {one.name: k for k, one in enumerate(copy.session.frames)}
    copy.masks(lambda mask, name: np.asarray(mask | known[(places[name] + shift) % len(known)]))


def _foreign(copy: Copy, _: Random) -> None:
    """Take three masks from another session."""
    frames, others = copy.session.frames, copy.other.frames
    for share in _FOREIGN_SHARES:
        place = int(share * len(frames))
        mask = others[place % len(others)].mask
        assert mask is not None
        write_image(copy.folder / "masks" / f"{frames[place].name}.png", read_mask(mask))


def _moved_base(copy: Copy, _: Random) -> None:
    """Take masks and readings of the second half from another session, whose base lies elsewhere."""
    frames, others = copy.session.frames, copy.other.frames
    later = {one.name: others[k % len(others)] for k, one in enumerate(frames) if k >= len(frames) // 2}
    for name, one in later.items():
        assert one.mask is not None
        write_image(copy.folder / "masks" / f"{name}.png", read_mask(one.mask))

    def of_both(rows: list[dict[str, str]]) -> list[dict[str, str]]:
        read = {name: {joint: f"{value:.6f}" for joint, value in one.readings.items()} for name, one in later.items()}
        return [{**row, **read.get(row.get("frame", ""), {})} for row in rows]

    copy.readings(of_both)


def _late(copy: Copy, _: Random) -> None:
    """Let the readings be two frames late."""

    def shifted(rows: list[dict[str, str]]) -> list[dict[str, str]]:
        before = [rows[0]] * _LATE_BY + rows[:-_LATE_BY]
        return [
            {**old, "frame": row["frame"]} if "frame" in row else old for row, old in zip(rows, before, strict=True)
        ]

    copy.readings(shifted)


def _wrist(pitch: str, yaw: str, sign: float) -> Callable[[Copy, Random], bool | None]:
    def row_of(row: dict[str, str]) -> dict[str, str]:
        return {**row, "wrist_pitch": str(sign * float(row[pitch])), "wrist_yaw": str(sign * float(row[yaw]))}

    return lambda copy, _: copy.readings(lambda rows: [row_of(row) for row in rows])


def _readings_off(copy: Copy, rng: Random) -> None:
    """Change the reading of wrist pitch or wrist yaw by 60 degrees, towards zero, in each frame."""

    def changed(row: dict[str, str]) -> dict[str, str]:
        name = ("wrist_pitch", "wrist_yaw")[rng.integers(2)]
        value = float(row[name])
        return {**row, name: str(value - np.copysign(_READING_OFF, value))}

    copy.readings(lambda rows: [changed(row) for row in rows])


def _disc(size: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1)), np.uint8)


def _changed(operation: int, size: int) -> Callable[[Copy, Random], bool | None]:
    """Return the falsification by a morphological operation with a disc of a radius, px."""
    return _masks(lambda mask, _: np.asarray(cv2.morphologyEx(mask.astype(np.uint8), operation, _disc(size)) > 0))


def _jaws_cut(copy: Copy, _: Random) -> None:
    """Remove the last third of the jaws from each mask."""

    def cut(mask: Bool, name: str) -> Bool:
        _, wrist, middle, *tips = copy.skeleton(name)
        along, (v, u) = (middle - wrist) / np.linalg.norm(middle - wrist), np.indices(mask.shape)
        reach = max((tip - wrist) @ along for tip in tips)
        beyond = (u - wrist[0]) * along[0] + (v - wrist[1]) * along[1] > 2 / 3 * reach
        return np.asarray(mask & ~beyond)

    copy.masks(cut)


def _halo(copy: Copy, _: Random) -> None:
    """Widen each mask by 2 px on one side of the shaft alone, as by a shadow."""

    def wider(mask: Bool, name: str) -> Bool:
        root, *_ = copy.skeleton(name)
        shaft = copy.session.truth.frames[name].camera_from_root @ np.array([0.0, 0.0, -0.01, 1.0])
        back = copy.session.rig.camera.project(shaft[None, :3])[0] - root
        along, (v, u) = back / np.linalg.norm(back), np.indices(mask.shape)
        behind = (u - root[0]) * along[0] + (v - root[1]) * along[1] > 0
        beside = (u - root[0]) * along[1] - (v - root[1]) * along[0] > 0
        return np.asarray(mask | (cv2.dilate(mask.astype(np.uint8), _disc(2)) > 0) & behind & beside)

    copy.masks(wider)


def _needle(copy: Copy, rng: Random) -> None:
    """Draw a suture needle, half a circle of some 8 mm radius, through the jaws of each frame."""
    focal = copy.session.rig.camera.fx

    def held(mask: Bool, name: str) -> Bool:
        truth = copy.session.truth.frames[name]
        scale = focal / truth.camera_from_root[2, 3]
        _, wrist, middle, *_ = copy.skeleton(name)
        at, radius = wrist + 0.75 * (middle - wrist), 8e-3 * scale * rng.uniform(0.8, 1.1)
        turn, start = rng.uniform(0, 2 * np.pi), float(rng.uniform(20, 160))
        centre, axes = at + radius * np.array([np.cos(turn), np.sin(turn)]), (round(radius), round(radius))
        image, where = mask.astype(np.uint8), centre.astype(int).tolist()
        angle = float(np.degrees(turn)) + 180.0 - start
        cv2.ellipse(image, where, axes, 0.0, angle, angle + 180.0, 1, max(2, round(0.8e-3 * scale)))
        return np.asarray(image > 0)

    copy.masks(held)


def _roll_off(copy: Copy, rng: Random) -> None:
    """Let the readings of roll be 15 to 22 degrees off, in all frames alike."""
    off = np.deg2rad(rng.uniform(15, 22)) * rng.choice([-1, 1])
    copy.readings(lambda rows: [{**row, "roll": str(float(row["roll"]) + off)} for row in rows])


def _by_lens(copy: Copy, rng: Random) -> None:
    copy.draw(rng, camera=replace(copy.session.rig.camera, distortion=(-0.3, 0.0, 0.0, 0.0, 0.0)))


def _larger(size: float) -> Callable[[Copy, Random], bool | None]:
    return lambda copy, rng: copy.draw(rng, size=size)


def _off_centre(px: float) -> Callable[[Copy, Random], bool | None]:
    def falsify(copy: Copy, rng: Random) -> None:
        right, down = px * rng.choice([-1, 1], 2) / np.sqrt(2)
        copy.camera(lambda camera: replace(camera, cx=camera.cx + right, cy=camera.cy + down))

    return falsify


def _focal(percent: float) -> Callable[[Copy, Random], bool | None]:
    def falsify(copy: Copy, rng: Random) -> None:
        factor = (1 + percent / 100) ** rng.choice([-1, 1])
        copy.camera(_scaled(factor, factor))

    return falsify


def _camera(change: Callable[[Camera], Camera]) -> Callable[[Copy, Random], bool | None]:
    return lambda copy, _: copy.camera(change)


def _scaled(x: float, y: float) -> Callable[[Camera], Camera]:
    return lambda camera: replace(camera, fx=x * camera.fx, fy=y * camera.fy)


def _half_size(camera: Camera) -> Camera:
    half = camera.scaled(camera.width // 2, camera.height // 2)
    return replace(camera, fx=half.fx, fy=half.fy, cx=half.cx, cy=half.cy)


INPUTS: Final[Mapping[str, Callable[[Copy, Random], bool | None]]] = {
    "right": lambda copy, rng: copy.draw(rng),
    **{f"focal length {percent} % off": _focal(percent) for percent in (2, 4, 6, 8)},
    "5:4 squeezed to 4:3": _camera(_scaled(1.0, 1 / 0.9375)),
    "principal point 20 px off": _off_centre(20),
    "principal point 40 px off": _off_centre(40),
    "k1 -0.3 not in the file": _by_lens,
    "tool 2 % larger": _larger(1.02),
    "tool 5 % larger": _larger(1.05),
    "mask opened by 6 px": _changed(cv2.MORPH_OPEN, 6),
    "mask opened by 10 px": _changed(cv2.MORPH_OPEN, 10),
    "last third of the jaws missing": _jaws_cut,
    "halo of 2 px beside the shaft": _halo,
    "mask 1 px wide": _changed(cv2.MORPH_DILATE, 1),
    "mask 2 px wide": _changed(cv2.MORPH_DILATE, 2),
    "both wrist signs wrong": _wrist("wrist_pitch", "wrist_yaw", -1.0),
    "needle in the jaws": _needle,
    "roll 15 to 22 deg off": _roll_off,
    "base wanders by 2 mm": lambda copy, rng: copy.draw(rng, wander_m=2e-3),
}
"""Falsified inputs (`--falsify inputs`): one thing of camera, tool, masks or readings that users rarely know of."""

FALSIFIED: Final[Mapping[str, Callable[[Copy, Random], bool | None]]] = {
    "hook for needle driver": _drawn_by("instrument_400183.urdf"),
    "Maryland for needle driver": _drawn_by("instrument_400172.urdf"),
    "another LND's meshes": _drawn_by("instrument_400006.urdf"),
    "something else": _masks(_something_else),
    "two tools": _two_tools,
    "half a mask": _masks(_half),
    "mirrored mask": _masks(lambda mask, _: np.ascontiguousarray(mask[:, ::-1])),
    "cropped and rescaled mask": _masks(_enlarged),
    "corner cropped, resized back": _masks(lambda mask, rng: _enlarged(mask, rng, 0.75)),
    "mask 3 px wide": _changed(cv2.MORPH_DILATE, 3),
    "readings 60 deg off": _readings_off,
    "wrist columns exchanged": _wrist("wrist_yaw", "wrist_pitch", 1.0),
    "focal length 15 % long": _camera(_scaled(1.15, 1.15)),
    "focal length 10 % long": _camera(_scaled(1.1, 1.1)),
    "focal length 10 % short": _camera(_scaled(1 / 1.1, 1 / 1.1)),
    "fx and fy 15 % apart": _camera(_scaled(1.0, 1.15)),
    "centre 50 px off": _camera(lambda camera: replace(camera, cx=camera.cx + 50)),
    "cx and cy exchanged": _camera(lambda camera: replace(camera, cx=camera.cy, cy=camera.cx)),
    "camera file of half the size": _camera(_half_size),
    "3 masks of another session": _foreign,
    "readings 2 frames late": _late,
    "base moved half way": _moved_base,
    "wrong arm": lambda copy, _: None,
    **INPUTS,
}
"""Kinds of falsification: each changes a copy; False where it cannot be made."""
_OPTIONS: Final[Mapping[str, tuple[str, ...]]] = {"wrong arm": ("--arm", "si")}


def falsified(folder: Path, other: Path, kind: str, out: Path, instrument: Instrument) -> Copy | None:
    """Write a falsified copy of a session of one eye with masks; None if the kind cannot be made of it."""
    if not (folder / "golden.json").exists():
        return None
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(folder, out, ignore=shutil.ignore_patterns("images", "video*", "*.json"))
    shutil.copy(folder / "golden.json", out)
    known = instrument.joint_names
    own, another = (read_session(each, known=known) for each in (folder, other))
    copy = Copy(out, own, another, instrument, _OPTIONS.get(kind, ()))
    rng = np.random.default_rng([*kind.encode(), *folder.name.encode()])
    return None if FALSIFIED[kind](copy, rng) is False else copy
