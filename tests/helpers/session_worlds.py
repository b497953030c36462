"""Sessions in memory with known truth, for tests of calibration: as masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvrk_cmaes import Body, Camera, EstimateConfig, FrameData, Instrument, Result, SessionCalibration, SessionFrame
from dvrk_cmaes.calibration.blocks import BASE_AXES
from dvrk_cmaes.calibration.model import named_deviations, usual_deviations
from dvrk_cmaes.camera.ros import write_camera_info
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.results.result import Alternative, Quality
from dvrk_cmaes.synth.levels import LEVELS, LevelName
from dvrk_cmaes.synth.session import SessionPlan, make_frames, make_truths
from dvrk_cmaes.synth.truth import Truth
from helpers.files import write_json
from helpers.transforms import moved

SEEN = np.array([2e-4, 2e-4, 6e-4, *np.deg2rad([0.3, 0.3, 3.0]), *np.deg2rad([2.0, 2.0, 2.0])])
"""Standard deviations of a pose and joints estimated from an outline, in the root's axes."""

FITTED = 0.15 * SEEN
"""Standard deviations of results on exact masks."""

_COLUMNS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw")

SMALL = Camera(320, 240, 513, 513, 161, 119)
"""The synthetic sessions' camera at a reduced resolution."""


def make_frames_in_memory(
    body: Body,
    frames: int = 6,
    *,
    seed: int = 3,
    level: LevelName = "easy",
    camera: Camera = SMALL,
) -> tuple[np.ndarray, list[Truth], list[SessionFrame]]:
    """Make masks and readings of a moving arm, and a result near the truth for each frame.

    Returns camera_from_base (4, 4), the frames' truth, and the frames; they are made once for the same arguments.
    """
    base, truths, made = _frames_in_memory(body, frames, seed, level, camera)
    return base.copy(), list(truths), list(made)


@cache
def _frames_in_memory(
    body: Body, frames: int, seed: int, level: LevelName, camera: Camera
) -> tuple[np.ndarray, list[Truth], list[SessionFrame]]:
    plan = SessionPlan(body, camera, LEVELS[level], "rcm", frames, seed, {})
    base, truths = make_truths(plan)
    assert base is not None
    rng = np.random.default_rng(seed)
    made = [
        SessionFrame(
            one.name,
            FrameData.of(one.mask, camera, one.ignore),
            near_the_truth(body.instrument, one.name, one.truth, one.readings, rng),
        )
        for one in make_frames(plan, truths)
    ]
    return base, truths, made


def near_the_truth(
    instrument: Instrument, name: str, truth: Truth, readings: Mapping[str, float], rng: np.random.Generator
) -> Result:
    """Sample a result about the truth with its stated covariance, and the mirror twin as its alternative."""
    off = rng.standard_normal(6 + len(truth.values)) * FITTED
    pose, joints = moved(truth.camera_from_root, off[:6]), truth.values + off[6:]
    other, bent = instrument.twin(pose, joints)
    names = instrument.joint_names
    return Result(
        frame=name,
        status="ok",
        reasons=(),
        instrument=instrument.name,
        root_link=instrument.root_link,
        camera_from_root=pose,
        joints=dict(zip(names, joints.tolist(), strict=True)),
        readings=dict(readings),
        quality=Quality(0.95, 0.1, {}, 0.8, 2.0),
        covariance=np.diag(FITTED**2),
        alternatives=(
            Alternative(other, dict(zip(names, bent.tolist(), strict=True)), 0.1, 0.94, "mirror twin", 30.0),
        ),
        config=EstimateConfig().as_dict(),
    )


def tip_mm(result: Result, truth: Truth) -> float:
    """Give the mean distance of the tips of a result from their true positions, mm."""
    assert len(result.tips) == 2
    return 1e3 * float(np.linalg.norm(np.array(result.tips) - truth.tips, axis=1).mean())


def in_other_mode(frame: SessionFrame) -> SessionFrame:
    """Return the frame with its result and its first alternative exchanged."""
    result = frame.result
    assert result.camera_from_root is not None
    other = result.alternatives[0]
    mine = replace(other, camera_from_root=result.camera_from_root, joints=result.joints)
    changed = replace(result, camera_from_root=other.camera_from_root, joints=other.joints, alternatives=(mine,))
    return replace(frame, result=changed)


def with_result(frame: SessionFrame, **changes: Any) -> SessionFrame:
    """Return the frame with its result changed."""
    return replace(frame, result=replace(frame.result, **changes))


def true_calibration(
    body: Body, base: np.ndarray, truths: list[Truth], frames: list[SessionFrame]
) -> SessionCalibration:
    """Return the true calibration, with a base known to 0.3 mm and 0.3 deg."""
    names = ("insertion", "roll", *body.instrument.joint_names)
    true = [{**truth.outer, **truth.joints} for truth in truths]
    off = [[t[name] - f.result.readings[name] for name in names] for t, f in zip(true, frames, strict=True)]
    spreads = usual_deviations(SessionConfig(), body.instrument.joint_names)
    covariance = np.diag([*[(3e-4) ** 2] * 3, *[np.deg2rad(0.3) ** 2] * 3, *[1e-6] * len(names)])
    return SessionCalibration(
        instrument=body.instrument.name,
        camera_from_base=base,
        offsets=dict(zip(names, np.mean(off, axis=0).tolist(), strict=True)),
        axes=(*BASE_AXES, *names),
        covariance=covariance,
        covariance_given_camera=covariance,
        spreads=named_deviations(spreads, body.instrument.joint_names),
        frames=tuple(frame.name for frame in frames),
        iou=0.95,
        contour_px_95=2.0,
        roll_offset=body.instrument.roll_offset,
    )


def write_folder(folder: Path, frames: list[SessionFrame]) -> None:
    """Write frames as a session folder, and their results as a batch does, into ``results`` beside it."""
    (folder / "masks").mkdir(parents=True)
    lines = [",".join(("frame", *_COLUMNS))]
    for one in frames:
        assert isinstance(one.data, FrameData)
        image = one.data.mask.astype(np.uint8) * 255
        (folder / "masks" / f"{one.name}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
        lines.append(",".join((one.name, *(f"{one.result.readings[name]:.6f}" for name in _COLUMNS))))
        write_json(folder.parent / "results" / "frames" / f"{one.name}.json", one.result.to_dict())
    write_camera_info(folder / "camera.yaml", SMALL, "synth")
    (folder / "joints.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
