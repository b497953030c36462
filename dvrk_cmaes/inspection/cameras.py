"""Inspection of camera files."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import read_intrinsics
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.inspection.finding import Finding, Options


def inspect_camera(path: Path, options: Options) -> Finding:
    """Describe a camera file; InputError if it is not valid."""
    found = read_intrinsics(path, rectified=options.rectified, side=options.side)
    notes = list(found.notes)
    distorted = found.model == "equidistant" or any(found.distortion)
    if found.size is None:
        size = "image size not stated"
        notes.append("without a stated image size, that of the masks or images is taken")
    else:
        size = f"{found.size[0]} x {found.size[1]} px"
        try:
            Camera(*found.size, found.fx, found.fy, found.cx, found.cy, found.distortion, found.model)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    if not options.rectified and "ROS" in found.kind:
        notes.append("images are taken for raw ones unless --rectified says otherwise")
    if "stereo" in found.kind or "camchain" in found.kind:
        notes.append("the left camera is taken unless --side says otherwise")
    lens = f"{found.model} {' '.join(f'{c:.6g}' for c in found.distortion)}" if distorted else "no distortion"
    read = asdict(found)
    del read["kind"], read["notes"]
    return Finding(
        "camera",
        (
            found.kind,
            f"{size}, focal lengths {found.fx:.3f} and {found.fy:.3f} px, "
            f"principal point {found.cx:.3f}, {found.cy:.3f}",
            lens,
        ),
        {"form": found.kind, **read},
        tuple(notes),
    )
