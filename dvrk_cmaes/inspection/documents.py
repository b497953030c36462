"""Inspection of JSON documents: dVRK descriptions and registrations, results, known poses, session calibrations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct
from numpy.typing import NDArray

from dvrk_cmaes.camera.document import is_camera, unwrapped
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.markers import read_marker_table
from dvrk_cmaes.frames.truth import read_golden
from dvrk_cmaes.inspection.cameras import inspect_camera
from dvrk_cmaes.inspection.finding import Finding, Options, counted, unit_of
from dvrk_cmaes.inspection.instruments import inspect_kinematics, inspect_tool
from dvrk_cmaes.instrument.dvrk_description import is_arm, is_description
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.io.typed_document import Number, Transform, convert_document
from dvrk_cmaes.results.file import read_result


class _BaseFrame(Struct, rename="kebab"):
    transform: Transform
    reference_frame: str | None = None


class _Registration(Struct, rename="kebab"):
    base_frame: _BaseFrame
    convention: str | None = None


class _Arm(Struct):
    name: str
    measured_cp: Transform | None = None


class _Arms(Struct):
    arms: tuple[_Arm, ...]


class _Summary(Struct):
    counts: dict[str, Any] | None = None


class _SessionFields(Struct):
    camera_from_base: Transform | None = None
    offsets: dict[str, Number] | None = None


def inspect_json(path: Path, options: Options) -> Finding:
    """Describe a JSON document of any known format; InputError if it is of none."""
    document = read_json_object(path, expected="a JSON document", comments=True)
    if is_description(document):
        return inspect_kinematics(path) if is_arm(document) else inspect_tool(path)
    storage = any(isinstance(value, dict) and "type_id" in value for value in document.values())
    if storage or is_camera(unwrapped(document)):
        return inspect_camera(path, options)
    if document and all(isinstance(value, dict) and "position_m" in value for value in document.values()):
        return _markers(path)
    for key, describe in _BY_KEY.items():
        if key in document:
            return describe(path, document)
    raise InputError(
        f"{path}: expected a dVRK tool, kinematics or registration, a result, a session or golden.json, "
        f"got the fields {listed(document) or '(none)'}"
    )


def _registration(path: Path, document: Mapping[str, Any]) -> Finding:
    """Describe a dVRK camera registration."""
    registration = convert_document(str(path), _with_hyphens(document), _Registration)
    pose, reference = registration.base_frame.transform, registration.base_frame.reference_frame or ""
    convention = registration.convention
    notes = () if convention else ("the camera's axes are not stated: OpenCV's, or the dVRK's with x and y reversed",)
    return Finding(
        "dVRK registration",
        (f"{convention or 'the base'} in {reference or 'an unnamed frame'}", _pose_text(pose)),
        {"reference_frame": reference, "transform": pose.tolist(), "convention": convention or None},
        notes,
    )


def _with_hyphens(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entry ``base_frame`` of version 2.4 of the dVRK with the keys of older versions."""
    if "base_frame" not in document:
        return dict(document)
    entry = document["base_frame"]
    if isinstance(entry, dict):
        entry = {key.replace("reference_frame", "reference-frame"): value for key, value in entry.items()}
    return {"base-frame": entry}


def _arms(path: Path, document: Mapping[str, Any]) -> Finding:
    """Describe a dVRK's system file, or its fixed setup joints (suj-fixed.json), which have poses of the arms."""
    arms = convert_document(str(path), document, _Arms).arms
    poses = {arm.name: arm.measured_cp for arm in arms if arm.measured_cp is not None}
    kind = "dVRK fixed setup joints (suj-fixed.json)" if poses else "dVRK system"
    lines = (f"arms: {listed(arm.name for arm in arms)}", *(f"{name}: {_pose_text(p)}" for name, p in poses.items()))
    return Finding(kind, lines, {"arms": [arm.name for arm in arms]})


def _result(path: Path, document: Mapping[str, Any]) -> Finding:
    """Describe the result of a frame."""
    result = read_result(path)
    lines = [f"frame {result.frame or '(unnamed)'}, {result.status}, {result.instrument or 'unnamed instrument'}"]
    if result.camera_from_root is not None:
        lines.append(f"{result.root_link or 'root'} in the camera: {_pose_text(result.camera_from_root)}")
    lines += result.reasons
    read = {"frame": result.frame, "status": result.status, "joints": result.joints, "readings": result.readings}
    return Finding("result", tuple(lines), read)


def _golden(path: Path, document: Mapping[str, Any]) -> Finding:
    """Describe a golden.json, or a summary of a batch, which has the field ``frames`` too."""
    frames = document["frames"]
    if isinstance(frames, dict) and any("status" in entry for entry in frames.values() if isinstance(entry, dict)):
        return _summary(path, document)
    truth = read_golden(path)
    base = "no base" if truth.camera_from_base is None else f"base: {_pose_text(truth.camera_from_base)}"
    line = f"poses and joints of {counted(len(truth.frames), 'frame')}: {listed(truth.frames)}"
    return Finding("known poses (golden.json)", (line, base), {"frames": list(truth.frames)})


def _summary(path: Path, document: Mapping[str, Any]) -> Finding:
    """Describe the summary of a batch."""
    counts = convert_document(str(path), document, _Summary).counts or {}
    text = ", ".join(f"{name} {count}" for name, count in counts.items())
    return Finding("summary of a batch", (text or "no counts",), {"counts": counts})


def _markers(path: Path) -> Finding:
    """Describe a table of marker positions."""
    markers = read_marker_table(path)
    line = f"{counted(len(markers), 'painted marker')} on {', '.join(dict.fromkeys(m.link for m in markers.values()))}"
    return Finding("marker positions", (line,), {"markers": {name: m.position.tolist() for name, m in markers.items()}})


def _session(path: Path, document: Mapping[str, Any]) -> Finding:
    """Describe a session calibration."""
    session = convert_document(str(path), document, _SessionFields)
    base, offsets = session.camera_from_base, session.offsets or {}
    lines = [f"base in the camera: {'not known' if base is None else _pose_text(base)}"]
    for name, value in offsets.items():
        scale, unit = unit_of(name)
        lines.append(f"offset of {name}: {scale * value:.2f} {unit}")
    return Finding("session calibration (session.json)", tuple(lines), {"offsets": offsets})


_BY_KEY: dict[str, Callable[[Path, Mapping[str, Any]], Finding]] = {
    "base-frame": _registration,
    "base_frame": _registration,
    "arms": _arms,
    "camera_from_root": _result,
    "rcm": _session,
    "frames": _golden,
}


def _pose_text(pose: NDArray[Any]) -> str:
    """Format a pose (4, 4) as a position, mm, and an axis-angle, degrees."""
    from scipy.spatial.transform import Rotation  # takes long to import

    turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True)
    return f"position {_triple(1e3 * pose[:3, 3])} mm, axis-angle {_triple(turn)} deg"


def _triple(values: NDArray[Any]) -> str:
    """Format numbers with two decimals, separated by blanks."""
    return " ".join(f"{value:.2f}" for value in values)
