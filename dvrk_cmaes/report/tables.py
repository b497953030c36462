"""What commands print and pages show of a result and of a calibration: lines of text, and tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.geometry import Float64, in_parent, log_rotation, rotation_angle
from dvrk_cmaes.io.csv_file import Table, fixed
from dvrk_cmaes.joints.names import shown_unit
from dvrk_cmaes.results.result import Result

_CAMERA = "the camera's axes"


def result_lines(result: Result) -> Iterator[str]:
    """Yield how accurate a result is and how well it fits, in words."""
    if result.expected_error is not None:
        yield result.expected_error.in_words
    q = result.quality
    if q is None:
        yield "no pose"
    else:
        yield f"IoU {q.iou:.3f}, contour {q.contour_px_median:.1f} px median, {q.contour_px_95:.1f} px at 95 %"
    if result.mode_probability is not None:
        yield f"in the right mode with a probability of {result.mode_probability:.2f}"


def result_tables(result: Result) -> Iterator[Table]:
    """Yield the tables of a frame: pose, joints and other modes, mm and deg."""
    rows: list[Sequence[str]] = []
    root = result.camera_from_root
    if root is not None:
        rows += _pose(result.root_link, root, _std(result.covariance_in_camera()))
    axes = {} if result.expected_error is None else result.expected_error.tip_axes_mm
    for k, tip in enumerate(result.tips, start=1):
        rows.append((f"tip {k}, mm", *_three(1e3 * tip)))
        if (std := axes.get("tip" if len(result.tips) == 1 else f"jaw_{k}")) is not None:
            rows.append((f"std along {_CAMERA}, mm", *_three(std)))
    if result.camera_from_base is not None:
        rows += _pose("arm's base (RCM)", result.camera_from_base)
    yield Table(("pose in the camera", "x", "y", "z"), rows)
    stds, joints = result.std_joints_deg or {}, []
    for name in dict.fromkeys([*result.joints, *result.readings]):
        factor, unit = shown_unit(name)
        found, read = (factor * values.get(name, math.nan) for values in (result.joints, result.readings))
        cells = fixed(found, 2), fixed(stds.get(name), 2), fixed(read, 2), fixed(found - read, 2, sign=True)
        joints.append((f"{name}, {unit}", *cells))
    yield Table(("joints", "found", "std", "read", "found - read"), joints)
    others = []
    for other in result.alternatives:
        apart = turned = math.nan
        if root is not None:
            apart = 1e3 * float(np.linalg.norm(other.camera_from_root[:3, 3] - root[:3, 3]))
            turned = math.degrees(float(rotation_angle(other.camera_from_root, root)))
        cells = f"{other.iou:.4f}", f"{other.loss:.4g}", fixed(other.reading_distance_deg, 1), fixed(apart, 1)
        others.append((other.relation, *cells, fixed(turned, 1)))
    yield Table(("other mode", "IoU", "loss", "from readings, deg", "apart, mm", "turned, deg"), others)


def calibration_lines(found: SessionCalibration) -> Iterator[str]:
    """Yield what a calibration says of lag, cameras, masks and cables, and what its session does not determine."""
    yield from found.in_words()
    if found.cables is not None:
        yield from found.cables.in_words()
    yield from (f"not determined by this session: {text}" for text in found.undetermined)
    if found.leave_one_out:
        own = f"mean IoU {found.predicted_iou:.3f}, contour {found.predicted_px:.1f} px median"
        yield f"{len(found.frames)} frames; each predicted by the others, without its image: {own}"


def calibration_tables(found: SessionCalibration) -> Iterator[Table]:
    """Yield the tables of a calibration: base, offsets of the readings, and the frames that are left out."""
    base = found.camera_from_base
    rows = list(_pose("arm's base (RCM)", base, _std(in_parent(base, found.covariance))))
    moves = found.endoscope
    if moves is not None:
        for stand in moves.bases:
            rows += _pose(f"frames {stand.first} to {stand.last}", stand.camera_from_base)
        for name, pose, stds in (
            ("camera in the endoscope's tip", moves.tip_from_camera, moves.std_tip_from_camera),
            ("arm's base in that of the endoscope's arm", moves.ecm_from_base, moves.std_ecm_from_base),
        ):
            if pose is not None:
                rows += _pose(name, pose, np.array(stds), "its own axes")
    yield Table(("arm's base in the camera", "x", "y", "z"), rows)
    offsets, std = [], np.sqrt(np.diag(found.covariance))[6:]
    for (name, offset), of_offset in zip(found.offsets.items(), std.tolist(), strict=True):
        factor, unit = shown_unit(name)
        values = fixed(factor * of_offset, 2), fixed(factor * found.spreads.get(name, 0.0), 2)
        offsets.append((f"{name}, {unit}", fixed(factor * offset, 2, sign=True), *values))
    yield Table(("true = read + offset", "offset", "std", "std between frames"), offsets)
    yield Table(("left out", "why"), list(found.left_out.items()), frames=True)


def _pose(name: str, pose: Float64, std: Float64 | None = None, axes: str = _CAMERA) -> Iterator[Sequence[str]]:
    """Yield the rows of a pose (4, 4), and of its standard deviations (6,), m and rad, along and about some axes."""
    yield f"{name}: position, mm", *_three(1e3 * pose[:3, 3])
    if std is not None:
        yield f"std along {axes}, mm", *_three(1e3 * std[:3])
    yield f"{name}: axis-angle, deg", *_three(np.degrees(log_rotation(pose[:3, :3])))
    if std is not None:
        yield f"std about {axes}, deg", *_three(np.degrees(std[3:6]))


def _std(covariance: Float64 | None) -> Float64 | None:
    """Return the standard deviations of a covariance; None without one."""
    return None if covariance is None else np.sqrt(np.diag(covariance))


def _three(values: Sequence[float] | Float64) -> tuple[str, ...]:
    return tuple(fixed(float(value), 2) for value in values)
