"""Calibrated sessions for tests of the page; the poses follow exactly from base, readings and offsets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dvrk_cmaes import Result, SessionCalibration
from dvrk_cmaes.calibration.blocks import BASE_AXES
from dvrk_cmaes.calibration.cables import CablesAlone, SessionCables
from dvrk_cmaes.calibration.document import Agreement
from dvrk_cmaes.draw.track_overlay import draw_outlines
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.results.folder import left_out_path
from dvrk_cmaes.results.tracked import TrackView
from helpers.files import write_image, write_json
from helpers.page_results import JOINTS, result, write_results
from helpers.transforms import exp_rotation, moved, transform

BASE = transform(exp_rotation([0.9, 1.8, -0.4]), [0.07, -0.07, 0.055])
OFFSETS = {"insertion": 4e-4, **dict(zip(("roll", *JOINTS), np.deg2rad([2, -8, 3, 5]).tolist(), strict=True))}
STD = {"insertion": 1e-4, **dict(zip(("roll", *JOINTS), np.deg2rad([1, 0.5, 0.5, 2]).tolist(), strict=True))}
BASE_STD = np.array([3e-4, 1e-4, 2e-4, *np.deg2rad([0.1, 0.2, 0.3])])
SPREADS = {name: 2.0 * std for name, std in STD.items()} | {"yaw": 2e-3, "pitch": 2e-3}
ROLL_OFFSET = 0.4162


def solved(names: Sequence[str], off: Mapping[str, Sequence[float]] | None = None) -> list[Result]:
    """Give frames of a session; ``off`` adds deviations (insertion in m, roll in rad) by frame."""
    frames = []
    for k, name in enumerate(names):
        outer = {"yaw": 0.3 - 0.11 * (k % 6), "pitch": 0.1 * (k % 4) - 0.2, "insertion": 0.12 + 0.004 * k, "roll": -0.6}
        true = outer | {joint: outer[joint] + OFFSETS[joint] for joint in ("insertion", "roll")}
        insertion, roll = (off or {}).get(name, (0.0, 0.0))
        pose = moved(BASE @ base_from_root(true, roll_offset=ROLL_OFFSET), [0, 0, insertion, 0, 0, roll])
        readings = {joint: value - OFFSETS[joint] for joint, value in JOINTS.items()} | outer
        frames.append(
            result(
                name, camera_from_root=pose, camera_from_base=BASE, readings=readings, source="session", seconds=1 + k
            )
        )
    return frames


def calibration(frames: Sequence[Result], **changes: object) -> SessionCalibration:
    """Give a calibration of the frames; later frames have better predictions."""
    one = SessionCalibration(
        instrument="lnd",
        camera_from_base=BASE,
        offsets=dict(OFFSETS),
        axes=(*BASE_AXES, *OFFSETS),
        covariance=np.diag([*BASE_STD, *STD.values()]) ** 2,
        covariance_given_camera=np.diag([*BASE_STD, *STD.values()]) ** 2,
        spreads={**SPREADS, "slack_translation": 2e-4, "slack_rotation": 2e-3},
        frames=tuple(frame.frame for frame in frames),
        leave_one_out={frame.frame: Agreement(0.8 + 0.01 * k, 3.0 - 0.1 * k) for k, frame in enumerate(frames)},
        iou=0.96,
        contour_px_95=2.1,
        roll_offset=ROLL_OFFSET,
    )
    return replace(one, **changes)  # type: ignore[arg-type]


def cables_of() -> SessionCables:
    """Give cables of which wrist_yaw drags wrist_pitch."""
    names = ("roll", *JOINTS)
    none, count = (0.0,) * len(names), len(names)
    zeros = (none,) * count
    coupling = tuple(tuple(0.25 * (j == 1 and k == 2) for k in range(count)) for j in range(count))
    play = tuple(tuple(0.5 * (j == k == 2) for k in range(count)) for j in range(count))
    return SessionCables(
        parts=("coupling", "play", "wander"),
        gain=20.0,
        joints=names,
        reference=none,
        coupling=coupling,
        coupling_std=((0.05,) * count,) * count,
        play=play,
        play_std=((0.1,) * count,) * count,
        wander=(0.01, 0.05, 0.05, 0.05),
        noise=(0.01,) * count,
        alone=CablesAlone(tuple(OFFSETS[name] for name in names), coupling, zeros, (0.05,) * count),
    )


def write_calibrated(
    out: Path, frames: Sequence[Result], session: SessionCalibration, *, pictures: Sequence[str] | None = None
) -> Path:
    """Write the output of ``calibrate``; returns its folder. ``pictures`` names the frames with one (default: all)."""
    write_results(out, frames)
    mask, predicted = (np.zeros((120, 160), bool) for _ in range(2))
    mask[40:80, 50:160], predicted[44:84, 40:160] = True, True
    drawn = draw_outlines([TrackView(None, mask, predicted, (160, 120))])
    for name in [frame.frame for frame in frames] if pictures is None else pictures:
        write_image(left_out_path(out, name), drawn)
    write_json(out / "session.json", session.to_dict())
    return out
