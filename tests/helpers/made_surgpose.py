"""Folders in the layout of SurgPose: two drawn arms, with labels at the points of the table and two more."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from dvrk_cmaes import Body, Camera, prepare
from dvrk_cmaes.frames.markers import Marker, place_markers, read_marker_table
from dvrk_cmaes.io.video_writer import quiet_ffmpeg
from dvrk_cmaes.synth.moving_arm import MotionLevel, moving_arm
from dvrk_cmaes.synth.moving_images import IMAGE_LEVELS, DrawnTool, RecordingImages
from dvrk_cmaes.synth.scene import exact_coverage
from dvrk_cmaes.synth.truth import Truth
from helpers.places import bundled_path
from helpers.transforms import apply, exp_rotation, moved, transform

CAMERA = Camera(350, 246, 453.0, 452.5, 171.5, 120.25, (-0.05, 0.02, 0.001, -0.0005, 0.0))
RIGHT_FROM_LEFT = transform(exp_rotation(np.array([0.002, -0.003, 0.001])), [-0.0053, 0.0001, 0.0])
FRAMES = 6
ARMS = ("PSM1", "PSM3")
NUMBERS: Mapping[str, Sequence[int]] = {"PSM1": range(1, 8), "PSM3": range(8, 15)}
JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
OFFSET_DEG = {"roll": 2.0, "wrist_pitch": 3.0, "wrist_yaw": -2.0}
"""How much the true joints of the made arms are larger than their readings."""

_SEEDS = {"PSM1": 20, "PSM3": 8}
_ASIDE = {"PSM1": 0.014, "PSM3": -0.012}
_OTHER_EDGE = {
    str(number): Marker("roll_link", np.array([0.0025, 0.0, z]))
    for numbers in NUMBERS.values()
    for number, z in zip(numbers[5:], (-0.001, -0.006), strict=True)
}
"""Points of the labels that the bundled table leaves out: 6, 7, 13 and 14."""
_STEADY = MotionLevel(1.5, 0.0, 0.0, 0.0, 0.0, 0.0, False, False)


@dataclass(frozen=True, eq=False)
class MadeArms:
    """Two arms that move in the view of a stereo endoscope, by name."""

    truths: Mapping[str, list[Truth]]
    body: Body

    @cached_property
    def labels(self) -> dict[str, list[dict[int, np.ndarray]]]:
        """Pixels (2,) of the table's points in the left images, by arm, frame and number."""
        table = {**read_marker_table(bundled_path("markers", "surgpose.json")), **_OTHER_EDGE}
        found: dict[str, list[dict[int, np.ndarray]]] = {}
        for arm, truths in self.truths.items():
            own = {str(number): table[str(number)] for number in NUMBERS[arm]}
            for truth in truths:
                placed = place_markers(truth.instrument, truth.values, own)
                points = apply(truth.camera_from_root, np.stack(list(placed.values())))
                pixels = CAMERA.project(points)
                found.setdefault(arm, []).append(dict(zip(NUMBERS[arm], pixels, strict=True)))
        return found

    def coverages(self, frame: int, right: bool = False) -> dict[str, np.ndarray]:
        """Shares (H, W) of the pixels that each tool covers in an eye's image."""
        return {arm: exact_coverage(CAMERA, self._seen(arm, right)[frame]) for arm in ARMS}

    def image(self, frame: int, right: bool = False) -> np.ndarray:
        """Draw an eye's image, (H, W, 3)."""
        tools = [DrawnTool(self._seen(arm, right), cover) for arm, cover in self.coverages(frame, right).items()]
        return RecordingImages(CAMERA, IMAGE_LEVELS["clean"], [1], 1 / 30).draw(frame, tools)

    def readings(self, arm: str, frame: int) -> list[float]:
        """Give the six readings of an arm in a frame."""
        truth = self.truths[arm][frame]
        joints = {**truth.outer, **truth.joints}
        return [float(joints[name] - np.deg2rad(OFFSET_DEG.get(name, 0.0))) for name in JOINTS]

    def _seen(self, arm: str, right: bool) -> list[Truth]:
        if not right:
            return self.truths[arm]
        return [replace(truth, camera_from_root=RIGHT_FROM_LEFT @ truth.camera_from_root) for truth in self.truths[arm]]


def made_arms(frames: int = FRAMES) -> MadeArms:
    """Move two arms, PSM1 on the right and PSM3 on the left."""
    body = prepare("lnd")
    truths = {}
    for arm in ARMS:
        aside = moved(np.eye(4), [_ASIDE[arm], 0.0, 0.0, 0.0, 0.0, 0.0])
        own = moving_arm(body, CAMERA, np.random.default_rng(_SEEDS[arm]), frames, _STEADY)[1]
        truths[arm] = [replace(truth, camera_from_root=aside @ truth.camera_from_root) for truth in own]
    return MadeArms(truths, body)


def calibration_ini(camera: Camera = CAMERA, **changes: object) -> str:
    """Give the text of StereoCalibrationDVRK.ini, lengths in millimetres; ``changes`` replace keys, None removes."""
    own: dict[str, object] = {"res_x": camera.width, "res_y": camera.height, "fc_x": camera.fx, "fc_y": camera.fy}
    own |= {"cc_x": camera.cx, "cc_y": camera.cy}
    own |= {f"kc_{k}": value for k, value in enumerate((*camera.distortion, 0.0, 0.0, 0.0))}
    pose = {f"R_{k}": value for k, value in enumerate(RIGHT_FROM_LEFT[:3, :3].ravel().tolist())}
    pose |= {f"T_{k}": 1e3 * value for k, value in enumerate(RIGHT_FROM_LEFT[:3, 3].tolist())}
    lines = []
    for name, keys in (("StereoLeft", own), ("StereoRight", {**own, **pose})):
        kept = {key: changes.get(key, value) for key, value in keys.items()}
        lines += [f"[{name}]", *(f"{key} = {value}" for key, value in kept.items() if value is not None)]
    return "\n".join(lines) + "\n"


def write_surgpose(folder: Path, arms: MadeArms, *, rate: float = 30.0) -> Path:
    """Write the folder of two arms; labels 6, 7, 13 and 14 are null but in the first frame."""
    frames = len(arms.truths["PSM1"])
    (folder / "regular").mkdir(parents=True)
    quiet_ffmpeg()
    for side in ("left", "right"):
        path, code = folder / "regular" / f"{side}_video.mp4", cv2.VideoWriter.fourcc(*"mp4v")
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, rate, (CAMERA.width, CAMERA.height))
        assert writer.isOpened()
        for k in range(frames):
            writer.write(arms.image(k, side == "right"))
        writer.release()
    joints = {str(k): {arm: arms.readings(arm, k) for arm in ARMS} for k in range(frames)}
    write_yaml(folder / "api_jp_data.yaml", joints)
    write_yaml(folder / "keypoints_left.yaml", {k: _labels(arms, k) for k in range(frames)})
    boxes = {str(k): {str(n): _box(cover) for n, cover in enumerate(arms.coverages(k).values())} for k in range(frames)}
    (folder / "bbox_left.json").write_text(json.dumps(boxes), encoding="utf-8")
    (folder / "StereoCalibrationDVRK.ini").write_text(calibration_ini(), encoding="utf-8")
    return folder


def write_yaml(path: Path, document: Any) -> None:
    """Write plain values as YAML, a value a line."""
    path.write_text(yaml.safe_dump(document), encoding="utf-8")


def _labels(arms: MadeArms, frame: int) -> dict[int, list[float] | None]:
    """Give the labels of both arms in a frame."""
    rare = (6, 7, 13, 14)
    all_of_them = {number: pixel for arm in ARMS for number, pixel in arms.labels[arm][frame].items()}
    return {
        number: None if number in rare and frame > 0 else [round(float(value), 3) for value in pixel]
        for number, pixel in all_of_them.items()
    }


def _box(coverage: np.ndarray) -> list[int]:
    """Give left, top, width and height of what is covered."""
    rows, columns = np.nonzero(coverage > 0.5)
    return [int(columns.min()), int(rows.min()), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1]
