"""Synthetic sessions: frames of a level with their true poses, written as a session folder.

The folder has camera.yaml (left.yaml and right.yaml of two eyes), joints.csv, masks/, images/, ignore/, keypoints.csv,
markers.csv, golden.json, and synth.json with the parameters. The same level, motion, seed, instrument, camera and
number of frames give the same session. With another number of frames, the poses may differ from the first frame on.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.markers import Marker, place_markers
from dvrk_cmaes.frames.session_toml import SESSION_FILE, CameraEntry, ToolEntry, session_toml
from dvrk_cmaes.frames.truth import SessionTruth, write_golden
from dvrk_cmaes.geometry import Bool, Float64, transform
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.io.encode import encoded_fields
from dvrk_cmaes.io.json_file import write_image, write_json, write_text
from dvrk_cmaes.io.output import whole_folder
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.files import write_joints
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.synth.levels import LEVELS, Level
from dvrk_cmaes.synth.masks import simulate_segmentation
from dvrk_cmaes.synth.occluders import dilate_region, outside_lens_circle, tissue_over_jaw
from dvrk_cmaes.synth.poses import ViewLimits, arm_session, free_poses
from dvrk_cmaes.synth.readings import sample_readings
from dvrk_cmaes.synth.scene import exact_mask
from dvrk_cmaes.synth.truth import Truth

Motion = Literal["free", "rcm", "video"]
Cables = Literal["independent", "measured"]

PLAN_FILE: Final = "synth.json"
"""File of a synthetic session's parameters; its presence marks a folder as a synthetic session."""

_HIDDEN: Final = (0.001, 0.004)  # m, range of the length of a jaw that tissue covers
_LUMP: Final = (25.0, 50.0)  # px at 640 x 480, range of the radius of the tissue


@dataclass(frozen=True, eq=False)
class SyntheticFrame:
    """A synthetic frame: the truth, and the simulated readings, mask and detections.

    name : name of the frame.
    truth : true pose and joints.
    mask, ignore : (H, W); ``ignore`` is None if no pixels are ignored.
    readings : by joint, rad and m.
    tips : (2, 2) px in either order, None if one is hidden or there are no jaws.
    markers : pixels (2,) of the detected markers, by name.
    holes, occluder, outside_lens : (H, W), specular highlights, tissue, and pixels outside the field of view; None if
        there are none.
    """

    name: str
    truth: Truth
    mask: Bool
    ignore: Bool | None
    readings: Mapping[str, float]
    tips: Float64 | None
    markers: Mapping[str, Float64]
    holes: Bool | None
    occluder: Bool | None
    outside_lens: Bool | None


@dataclass(frozen=True, eq=False)
class SessionPlan:
    """Parameters of a synthetic session.

    body, camera : instrument and camera. level : difficulty.
    motion : ``rcm`` for an arm that moves about its RCM, ``free`` for independent poses, ``video`` for consecutive
        frames of a moving arm (see `synth.recording`).
    frames : number of frames. seed : seed of all random numbers.
    markers : markers painted on the instrument, by name; may be empty.
    arm : kinematics of the arm.
    lag : of a video, lag of its images behind its readings, frames; that of the level by default.
    cables : of a video, ``measured`` for readings that err as those of a real arm, ``independent`` for errors of each
        joint by itself.
    baseline : distance of the right eye from the left, m; None for one view. Both eyes have the same camera.
    tool : what session.toml says of the instrument; without it, none is written.
    steered : whether the endoscope of a video is steered to other places, and the readings of its arm are written.
    """

    body: Body
    camera: Camera
    level: Level
    motion: Motion
    frames: int
    seed: int
    markers: Mapping[str, Marker]
    arm: Arm = "classic"
    lag: float | None = None
    cables: Cables = "independent"
    baseline: float | None = None
    tool: ToolEntry | None = None
    steered: bool = False

    @property
    def right_from_left(self) -> Float64:
        """Pose (4, 4) of the left camera in the right one's frame, m."""
        return transform(np.eye(3), [-(self.baseline or 0.0), 0.0, 0.0])

    @property
    def tools(self) -> list[ToolEntry]:
        """What session.toml says of the instrument; none without it."""
        return [] if self.tool is None else [self.tool]

    def describe(self) -> dict[str, Any]:
        """Return the parameters as plain values for JSON."""
        return {
            **encoded_fields(self, "level", "motion", "frames", "seed"),
            "instrument": self.body.instrument.name,
            "arm": self.arm,
            "roll_offset": self.body.instrument.roll_offset,
            "version": __version__,
            **({} if self.baseline is None else {"baseline": self.baseline}),
            **({"steered": True} if self.steered else {}),
        }


def default_camera(level: Level) -> Camera:
    """Return the default camera of a level: an endoscope of 640 x 480 px with the level's distortion."""
    return Camera(640, 480, fx=1026.0, fy=1026.0, cx=322.0, cy=238.0, distortion=level.distortion)


def check_shaft(plan: SessionPlan) -> None:
    """Raise an InputError if the instrument has no shaft."""
    if plan.body.instrument.shaft is None:
        raise InputError(f"{plan.body.instrument.name}: expected an instrument with a straight shaft, got one without")


def frame_name(plan: SessionPlan, number: int) -> str:
    """Return the name of a frame: its number, from 0, with leading zeros."""
    return f"{number:0{max(4, len(str(plan.frames - 1)))}d}"


def make_truths(plan: SessionPlan) -> tuple[Float64 | None, list[Truth]]:
    """Draw the session's true poses: ``camera_from_base`` (4, 4), None for free motion, and the truth of each frame.

    Raises
    ------
    DvrkCmaesError
        Too few poses were found in which the instrument is well visible in the camera.
    InputError
        The instrument has no shaft.
    """
    check_shaft(plan)
    level = plan.level
    view = ViewLimits(level.least_tilt_deg, level.arm_tilt_deg, level.least_bend_deg, level.least_jaw_px)
    rng = _generator(plan, 0)
    if plan.motion == "free":
        return None, free_poses(plan.body, plan.camera, rng, plan.frames, view)
    return arm_session(plan.body, plan.camera, rng, plan.frames, view, arm=plan.arm)


def make_frames(plan: SessionPlan, truths: list[Truth]) -> Iterator[SyntheticFrame]:
    """Yield the frames of a session with given true poses; errors as in `sample_readings`."""
    readings = sample_readings(truths, _generator(plan, 1), plan.level, one_session=plan.motion == "rcm")
    for k, (truth, reading) in enumerate(zip(truths, readings, strict=True)):
        yield _frame(plan, frame_name(plan, k), truth, reading, _generator(plan, 2, k))


def right_view(plan: SessionPlan, frame: SyntheticFrame) -> SyntheticFrame:
    """Return a frame as the right eye sees it: the same instrument and tissue, with mistakes of their own."""
    seen = replace(frame.truth, camera_from_root=plan.right_from_left @ frame.truth.camera_from_root)
    number = int(frame.name)
    same_tissue = _generator(plan, 2, number)
    return _frame(plan, frame.name, seen, frame.readings, _generator(plan, 4, number), same_tissue)


def write_session(out: Path, plan: SessionPlan, *, images: bool = True, overwrite: bool = False) -> None:
    """Make a session and write it to the folder ``out``, completely or, after an error, not at all.

    ``images`` says whether images are drawn; ``overwrite`` whether an earlier synthetic session is replaced.

    Raises
    ------
    InputError
        The folder is not empty, or cannot be written to; the instrument has no shaft.
    DvrkCmaesError
        As in `make_truths` and `make_frames`.
    """
    with whole_folder(out, "synth", overwrite=overwrite) as folder:
        camera_from_base, truths = make_truths(plan)
        readings: dict[str, Mapping[str, float]] = {}
        tips, markers, golden = [], [], {}
        for frame in make_frames(plan, truths):
            views = {".": frame} if plan.baseline is None else {"left": frame, "right": right_view(plan, frame)}
            for view, seen in views.items():
                _write_view(folder, plan, view, seen, images=images)
            readings[frame.name] = frame.readings
            pixels = ["", "", "", ""] if frame.tips is None else [f"{value:.2f}" for value in frame.tips.ravel()]
            tips.append([frame.name, *pixels])
            markers += [[frame.name, name, f"{u:.2f}", f"{v:.2f}"] for name, (u, v) in frame.markers.items()]
            golden[frame.name] = frame.truth.stated
        write_cameras(folder, plan, plan.tools)
        columns = [*(OUTER_JOINTS if camera_from_base is not None else ()), *plan.body.instrument.joint_names]
        write_joints(folder / "joints.csv", readings, columns)
        if plan.body.instrument.jaw_tips:
            write_text(folder / "keypoints.csv", csv_text(("frame", "tip_1_u", "tip_1_v", "tip_2_u", "tip_2_v"), tips))
        if plan.markers:
            write_text(folder / "markers.csv", csv_text(("frame", "marker", "u", "v"), markers))
        write_golden(folder / "golden.json", SessionTruth(golden, camera_from_base))
        write_json(folder / PLAN_FILE, plan.describe())


def write_cameras(folder: Path, plan: SessionPlan, tools: Sequence[ToolEntry]) -> None:
    """Write the camera files and, if there are any ``tools``, session.toml."""
    if plan.baseline is None:
        write_camera_info(folder / "camera.yaml", plan.camera, "synth")
        entry = CameraEntry(file=Path("camera.yaml"))
    else:
        write_camera_info(folder / "left.yaml", plan.camera, "synth_left")
        write_camera_info(folder / "right.yaml", plan.camera, "synth_right", baseline=plan.baseline)
        entry = CameraEntry(left=Path("left.yaml"), right=Path("right.yaml"))
    if tools:
        write_text(folder / SESSION_FILE, session_toml(entry, tools))


def _write_view(folder: Path, plan: SessionPlan, view: str, frame: SyntheticFrame, *, images: bool) -> None:
    """Write mask, ignored pixels and image of a frame to the folders of a view."""
    write_image(folder / "masks" / view / f"{frame.name}.png", frame.mask)
    if frame.ignore is not None:
        write_image(folder / "ignore" / view / f"{frame.name}.png", frame.ignore)
    if images:
        write_image(folder / "images" / view / f"{frame.name}.png", draw_frame(plan, frame))


def draw_frame(plan: SessionPlan, frame: SyntheticFrame) -> NDArray[np.uint8]:
    """Draw the image of a frame, (H, W, 3) uint8 BGR."""
    rng = _generator(plan, 3, int(frame.name))
    return draw_image(
        plan.camera, frame.truth, rng, holes=frame.holes, occluder=frame.occluder, outside_lens=frame.outside_lens
    )


def _generator(plan: SessionPlan, *stream: int) -> np.random.Generator:
    """Return a random generator that depends on seed, level, motion and ``stream``; each part has its own stream."""
    return np.random.default_rng([plan.seed, list(LEVELS).index(plan.level.name), plan.motion == "rcm", *stream])


def _frame(
    plan: SessionPlan,
    name: str,
    truth: Truth,
    reading: Mapping[str, float],
    rng: np.random.Generator,
    rng_of_tissue: np.random.Generator | None = None,
) -> SyntheticFrame:
    """Simulate a frame; ``rng_of_tissue`` draws the tissue before the instrument, where not ``rng`` does."""
    camera, level = plan.camera, plan.level
    outside_lens = None if level.lens_edge is None else outside_lens_circle(camera, level.lens_edge)
    occluder, stated = _tissue(plan, truth, rng_of_tissue or rng)
    mask, holes = exact_mask(camera, truth), None
    hidden = _union(occluder, outside_lens)
    if level.mistakes is None:
        mask = mask if hidden is None else mask & ~hidden
    else:
        made = simulate_segmentation(mask, rng, level.mistakes, hidden)
        mask, holes = made.mask, made.holes
    ignore = _union(dilate_region(occluder) if occluder is not None and stated else None, outside_lens)
    tips, markers = _seen_tips(camera, truth, hidden, level, rng), _seen_markers(plan, truth, hidden, rng)
    return SyntheticFrame(name, truth, mask, ignore, reading, tips, markers, holes, occluder, outside_lens)


def _union(a: Bool | None, b: Bool | None) -> Bool | None:
    """Return the union of two regions (H, W), each of which may be None."""
    if a is None or b is None:
        return b if a is None else a
    return a | b


def _tissue(plan: SessionPlan, truth: Truth, rng: np.random.Generator) -> tuple[Bool | None, bool]:
    """Draw the tissue (H, W) in front of a jaw, None in most frames, and whether ``ignore`` contains it."""
    occluded, stated, jaw = rng.random() < plan.level.occluded, rng.random() < plan.level.stated, int(rng.integers(2))
    hidden, radius = rng.uniform(*_HIDDEN), rng.uniform(*_LUMP) * np.sqrt(plan.camera.width * plan.camera.height) / 554
    if not occluded or not plan.body.instrument.jaw_tips:
        return None, False
    return tissue_over_jaw(plan.camera, truth, rng, radius=radius, hidden=hidden, jaw=jaw), stated


def _seen(region: Bool | None, pixel: Float64) -> bool:
    """Whether a pixel is in the image and not in a region (H, W); True if the region is None."""
    if region is None:
        return True
    column, row = np.rint(pixel).astype(int)
    inside = 0 <= row < region.shape[0] and 0 <= column < region.shape[1]
    return bool(inside and not region[row, column])


def _seen_tips(
    camera: Camera, truth: Truth, hidden: Bool | None, level: Level, rng: np.random.Generator
) -> Float64 | None:
    """Simulate the detection of both tips (2, 2), px, in random order; None if one is hidden or there are no jaws."""
    if not truth.instrument.jaw_tips:
        return None
    tips = camera.project(truth.tips)
    detected = np.asarray((tips + level.tip_px * rng.standard_normal(tips.shape))[rng.permutation(2)])
    return detected if all(_seen(hidden, tip) for tip in tips) else None


def _seen_markers(plan: SessionPlan, truth: Truth, hidden: Bool | None, rng: np.random.Generator) -> dict[str, Float64]:
    """Simulate the detection of markers, pixels (2,) by name; markers on the far side are not excluded."""
    level, pixels = plan.level, {}
    for name, place in place_markers(truth.instrument, truth.values, plan.markers).items():
        point = truth.camera_from_root[:3, :3] @ place + truth.camera_from_root[:3, 3]
        detected, noise = rng.random() < level.marker_share, level.marker_px * rng.standard_normal(2)
        if not detected or point[2] <= 0:
            continue
        pixel = plan.camera.project(point)
        inside = bool(((pixel > 0) & (pixel < [plan.camera.width - 1, plan.camera.height - 1])).all())
        if inside and _seen(hidden, pixel):
            pixels[name] = np.asarray(pixel + noise)
    return pixels
