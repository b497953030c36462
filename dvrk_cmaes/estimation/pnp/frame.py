"""Poses of a session's frames by the PnP baseline, as results in the same schema as those of an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter
from typing import Final, Literal

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation.pnp.points import PointPose, Solver, solve_points
from dvrk_cmaes.estimation.pnp.tips import solve_tips
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.markers import Marker, place_markers
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm, find_camera_from_base
from dvrk_cmaes.pose.doubts import points_off, reasons
from dvrk_cmaes.pose.expected_error import locate_tips
from dvrk_cmaes.results.result import Result

Points = Literal["markers", "tips"]

LARGEST_ERROR_PX: Final = 15.0
"""Root mean square reprojection error above which a result is doubtful."""


def pose_from_markers(
    files: FrameFiles,
    camera: Camera,
    instrument: Instrument,
    table: Mapping[str, Marker],
    seen: Mapping[str, Float64],
    *,
    solver: Solver = "sqpnp",
    arm: Arm = "classic",
) -> Result:
    """Find the pose of a frame from the markers seen in it.

    Parameters
    ----------
    files
        The frame, with its readings.
    camera, instrument
        The camera and the instrument.
    table
        Positions of the markers on the instrument's links, by name.
    seen
        Pixels (2,) of the markers seen, by name.
    solver
        The PnP solver, one of ``SOLVERS``.
    arm
        The arm, for the pose of its base.

    Returns
    -------
    Result
        Its status is ``failed``, with the reason, if no pose is found.

    Raises
    ------
    InputError
        A marker that is not in the table, or whose link the instrument does not have.
    """
    strangers = sorted(set(seen) - set(table))
    if strangers:
        raise InputError(f"frame {files.name}: marker {strangers[0]}: expected one of {', '.join(table)}")
    started = perf_counter()
    joints = _readings(files, instrument)
    answer: PointPose | str
    if isinstance(joints, str):
        answer = joints
    else:
        places = place_markers(instrument, joints, {name: table[name] for name in seen})
        pixels = np.array([seen[name] for name in places], dtype=np.float64).reshape(-1, 2)
        points = np.array(list(places.values()), dtype=np.float64).reshape(-1, 3)
        answer = solve_points(camera, pixels, points, solver)
    config = {"method": "pnp", "points": "markers", "solver": solver}
    return _result(files, camera, instrument, answer, config, perf_counter() - started, arm)


def pose_from_tips(data: FrameData, instrument: Instrument, *, arm: Arm = "classic", seed: int = 0) -> Result:
    """Find the pose of a frame from its two jaw tips and the shaft's edges in its mask; failed if either is missing.

    ``seed`` is that of the random numbers used in gathering the evidence.
    """
    started, files = perf_counter(), data.files
    joints = _readings(files, instrument)
    answer: PointPose | str
    if isinstance(joints, str):
        answer = joints
    elif files.keypoints is None:
        answer = "no jaw tips are given (keypoints.csv)"
    else:
        evidence = gather_evidence(
            data.mask, data.camera, instrument, ignore=data.ignore, keypoints=files.keypoints, seed=seed
        )
        if evidence.shaft_edges:
            answer = solve_tips(data.camera, instrument, joints, files.keypoints, evidence.shaft_edges[0])
        else:
            answer = next((text for text in evidence.unused if text.startswith("shaft edges")), "no shaft edges")
    config = {"method": "pnp", "points": "tips and shaft edges", "seed": seed}
    return _result(files, data.camera, instrument, answer, config, perf_counter() - started, arm)


def _readings(files: FrameFiles, instrument: Instrument) -> Float64 | str:
    """Return the readings (J,) of the instrument's joints, or a message that says which are missing."""
    missing = [name for name in instrument.joint_names if name not in files.readings]
    if missing:
        return f"no reading of {', '.join(missing)}, and points do not determine it"
    return np.array([files.readings[name] for name in instrument.joint_names], dtype=np.float64)


def _result(
    files: FrameFiles,
    camera: Camera,
    instrument: Instrument,
    answer: PointPose | str,
    config: Mapping[str, object],
    seconds: float,
    arm: Arm,
) -> Result:
    """Make a result of a pose or of a message that says why there is none; its joints are the readings."""
    posed = isinstance(answer, PointPose)
    found = [] if posed else [str(answer)]
    base = None
    tips: tuple[Float64, ...] = ()
    tips_px: tuple[Float64, ...] = ()
    if isinstance(answer, PointPose):
        found = reasons(points_off(answer.error_px, LARGEST_ERROR_PX * camera.pixel_scale))
        base = find_camera_from_base(answer.camera_from_root, files.readings, arm, roll_offset=instrument.roll_offset)
        joints = np.array([files.readings[name] for name in instrument.joint_names])
        tips, tips_px = locate_tips(instrument, camera, Posed(answer.camera_from_root, joints))
    return Result(
        frame=files.name,
        status="failed" if not posed else "doubtful" if found else "ok",
        reasons=tuple(found),
        **instrument.stated,
        camera_from_root=answer.camera_from_root if isinstance(answer, PointPose) else None,
        joints={n: files.readings[n] for n in instrument.joint_names if n in files.readings},
        readings=dict(files.readings),
        warnings=files.notes,
        camera_from_base=base,
        time=files.time,
        tips=tips,
        tips_px=tips_px,
        seconds=seconds,
        version=__version__,
        config={**config, "instrument": instrument.describe_limits(arm)},
        model=instrument,
    )
