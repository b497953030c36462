"""A made session: frames of a level with their truth, in our own session layout.

camera.yaml, joints.csv, masks/, images/, ignore/, keypoints.csv, markers.csv, golden.json, and synth.json, which says
how it was made. The same level, motion, seed, instrument and camera give the same frames; of sessions that differ only
in their number of frames, the shorter one's poses are not always the first of the longer one's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes._version import __version__
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.markers import Marker, place_markers
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, Arm
from dvrk_cmaes.io.atomic import write_image, write_json, write_text
from dvrk_cmaes.io.atomic_folder import whole_folder
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.files import rounded, rounded_truth, write_camera_info, write_joints
from dvrk_cmaes.synth.images import draw_image
from dvrk_cmaes.synth.levels import LEVELS, Level
from dvrk_cmaes.synth.masks import segmented
from dvrk_cmaes.synth.occluders import beyond_lens_edge, tissue_before_a_jaw, with_brim
from dvrk_cmaes.synth.poses import View, arm_session, free_poses
from dvrk_cmaes.synth.readings import drawn_readings
from dvrk_cmaes.synth.truth import Truth, exact_mask

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
Motion = Literal["free", "rcm"]

SIGN: Final = "synth.json"
"""File by which a made session is known."""

_HIDDEN: Final = (0.001, 0.004)  # m, of a jaw behind tissue
_LUMP: Final = (25.0, 50.0)  # px at 640 x 480, radius of the tissue


@dataclass(frozen=True, eq=False)
class MadeFrame:
    """A frame: what is true, and what a robot, a segmenter and detectors say of it.

    mask, ignore : (H, W); ignore is None where nothing is to be ignored.
    readings : by joint, rad and m.
    tips : (2, 2) px in either order, None where one is hidden or there are no jaws.
    markers : pixels (2,) by name, of those detected.
    holes, occluder, beyond : (H, W), what an image shows of glare, tissue and the lens's edge.
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
    beyond: Bool | None


@dataclass(frozen=True, eq=False)
class SessionPlan:
    """What a session is made of; ``markers`` are painted on the instrument, none for those without."""

    body: Body
    camera: Camera
    level: Level
    motion: Motion
    frames: int
    seed: int
    markers: Mapping[str, Marker]
    arm: Arm = "classic"

    def describe(self) -> dict[str, Any]:
        """Plain values that say how to make the session again."""
        return {
            "level": self.level.to_dict(),
            "motion": self.motion,
            "frames": self.frames,
            "seed": self.seed,
            "instrument": self.body.instrument.name,
            "arm": self.arm,
            "roll_offset": self.body.instrument.roll_offset,
            "version": __version__,
        }


def default_camera(level: Level) -> Camera:
    """Return the camera of a level's sessions: a 640 x 480 endoscope, from the medium level on with a barrel lens."""
    return Camera(640, 480, fx=1026.0, fy=1026.0, cx=322.0, cy=238.0, distortion=level.distortion)


def make_truths(plan: SessionPlan) -> tuple[Float64 | None, list[Truth]]:
    """Draw the session's true poses: ``camera_from_base`` (4, 4) or None, and one truth a frame.

    Raises
    ------
    DvrkCmaesError
        No sensible pictures are found of this instrument in this camera.
    InputError
        The instrument has no shaft.
    """
    if plan.body.instrument.shaft is None:
        raise InputError(f"{plan.body.instrument.name}: expected an instrument with a straight shaft, got one without")
    level = plan.level
    view = View(
        least_tilt=level.least_tilt_deg,
        arm_tilt=level.arm_tilt_deg,
        least_bend=level.least_bend_deg,
        least_jaw=level.least_jaw_px,
    )
    rng = _generator(plan, 0)
    if plan.motion == "free":
        return None, free_poses(plan.body, plan.camera, rng, plan.frames, view)
    return arm_session(plan.body, plan.camera, rng, plan.frames, view, arm=plan.arm)


def make_frames(plan: SessionPlan, truths: list[Truth]) -> Iterator[MadeFrame]:
    """Make the frames of a session whose truth is known, one after the other; DvrkCmaesError as `drawn_readings`."""
    readings = drawn_readings(truths, _generator(plan, 1), plan.level, one_session=plan.motion == "rcm")
    digits = max(4, len(str(plan.frames - 1)))
    for k, (truth, reading) in enumerate(zip(truths, readings, strict=True)):
        yield _frame(plan, f"{k:0{digits}d}", truth, reading, _generator(plan, 2, k))


def write_session(out: Path, plan: SessionPlan, *, images: bool = True, overwrite: bool = False) -> None:
    """Make a session and write it, whole or not at all.

    Raises
    ------
    InputError
        The folder has files in it, or cannot be written to; an instrument without a shaft.
    DvrkCmaesError
        As `make_truths` and `make_frames`.
    """
    with whole_folder(out, sign=SIGN, overwrite=overwrite) as folder:
        camera_from_base, truths = make_truths(plan)
        readings: dict[str, Mapping[str, float]] = {}
        tips, markers, golden = [], [], {}
        for frame in make_frames(plan, truths):
            write_image(folder / "masks" / f"{frame.name}.png", frame.mask)
            if frame.ignore is not None:
                write_image(folder / "ignore" / f"{frame.name}.png", frame.ignore)
            if images:
                write_image(folder / "images" / f"{frame.name}.png", draw_frame(plan, frame))
            readings[frame.name] = frame.readings
            pixels = ["", "", "", ""] if frame.tips is None else [f"{value:.2f}" for value in frame.tips.ravel()]
            tips.append(",".join([frame.name, *pixels]))
            markers += [f"{frame.name},{name},{u:.2f},{v:.2f}" for name, (u, v) in frame.markers.items()]
            golden[frame.name] = rounded_truth(frame.truth, "T_camera_roll_link", "tips_camera_m")
        write_camera_info(folder / "camera.yaml", plan.camera, "synth")
        columns = [*(OUTER_JOINTS if camera_from_base is not None else ()), *plan.body.instrument.joint_names]
        write_joints(folder / "joints.csv", readings, columns)
        if plan.body.instrument.jaw_tips:
            write_text(folder / "keypoints.csv", _csv("frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v", tips))
        if plan.markers:
            write_text(folder / "markers.csv", _csv("frame,marker,u,v", markers))
        base = None if camera_from_base is None else rounded(camera_from_base)
        write_json(folder / "golden.json", {"camera_from_base": base, "frames": golden})
        write_json(folder / SIGN, plan.describe())


def draw_frame(plan: SessionPlan, frame: MadeFrame) -> NDArray[np.uint8]:
    """Draw a frame's image, (H, W, 3) BGR."""
    rng = _generator(plan, 3, int(frame.name))
    return draw_image(plan.camera, frame.truth, rng, holes=frame.holes, occluder=frame.occluder, beyond=frame.beyond)


def _csv(header: str, rows: list[str]) -> str:
    return "\n".join([header, *rows]) + "\n"


def _generator(plan: SessionPlan, *stream: int) -> np.random.Generator:
    """Random numbers of their own for each part, so that more of one changes nothing in another."""
    return np.random.default_rng([plan.seed, list(LEVELS).index(plan.level.name), plan.motion == "rcm", *stream])


def _frame(
    plan: SessionPlan, name: str, truth: Truth, reading: Mapping[str, float], rng: np.random.Generator
) -> MadeFrame:
    camera, level = plan.camera, plan.level
    beyond = None if level.lens_edge is None else beyond_lens_edge(camera, level.lens_edge)
    occluder, told = _tissue(plan, truth, rng)
    mask, holes = exact_mask(plan.body, camera, truth), None
    hidden = _either(occluder, beyond)
    if level.mistakes is None:
        mask = mask if hidden is None else mask & ~hidden
    else:
        made = segmented(mask, rng, level.mistakes, hidden)
        mask, holes = made.mask, made.holes
    ignore = _either(with_brim(occluder) if occluder is not None and told else None, beyond)
    return MadeFrame(
        name=name,
        truth=truth,
        mask=mask,
        ignore=ignore,
        readings=reading,
        tips=_seen_tips(camera, truth, hidden, level, rng),
        markers=_seen_markers(plan, truth, hidden, rng),
        holes=holes,
        occluder=occluder,
        beyond=beyond,
    )


def _either(a: Bool | None, b: Bool | None) -> Bool | None:
    """Join two regions, either of which may not be there."""
    if a is None or b is None:
        return b if a is None else a
    return a | b


def _tissue(plan: SessionPlan, truth: Truth, rng: np.random.Generator) -> tuple[Bool | None, bool]:
    """Tissue before a jaw, if there is some, and whether it is told."""
    occluded, told, jaw = rng.random() < plan.level.occluded, rng.random() < plan.level.told, int(rng.integers(2))
    hidden, radius = rng.uniform(*_HIDDEN), rng.uniform(*_LUMP) * np.sqrt(plan.camera.width * plan.camera.height) / 554
    if not occluded or not plan.body.instrument.jaw_tips:
        return None, False
    return tissue_before_a_jaw(plan.camera, truth, rng, radius=radius, hidden=hidden, jaw=jaw), told


def _seen(region: Bool | None, pixel: Float64) -> bool:
    """Whether a pixel is in the image, outside a region."""
    if region is None:
        return True
    column, row = np.rint(pixel).astype(int)
    inside = 0 <= row < region.shape[0] and 0 <= column < region.shape[1]
    return bool(inside and not region[row, column])


def _seen_tips(
    camera: Camera, truth: Truth, hidden: Bool | None, level: Level, rng: np.random.Generator
) -> Float64 | None:
    """Detect both tips, in either order; None where one is hidden."""
    if not truth.instrument.jaw_tips:
        return None
    tips = camera.project(truth.tips)
    found = np.asarray((tips + level.tip_px * rng.standard_normal(tips.shape))[rng.permutation(2)])
    return found if all(_seen(hidden, tip) for tip in tips) else None


def _seen_markers(plan: SessionPlan, truth: Truth, hidden: Bool | None, rng: np.random.Generator) -> dict[str, Float64]:
    """Detect some of the markers; those on the far side are detected, too, which is kind to what starts from them."""
    level, found = plan.level, {}
    for name, place in place_markers(truth.instrument, truth.values, plan.markers).items():
        point = truth.camera_from_root[:3, :3] @ place + truth.camera_from_root[:3, 3]
        detected, noise = rng.random() < level.marker_share, level.marker_px * rng.standard_normal(2)
        if not detected or point[2] <= 0:
            continue
        pixel = plan.camera.project(point)
        inside = bool(((pixel > 0) & (pixel < [plan.camera.width - 1, plan.camera.height - 1])).all())
        if inside and _seen(hidden, pixel):
            found[name] = np.asarray(pixel + noise)
    return found
