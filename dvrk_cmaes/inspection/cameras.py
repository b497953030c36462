"""Inspection of camera files."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from dvrk_cmaes.camera.files import read_intrinsics
from dvrk_cmaes.inspection.finding import Finding, Options


def inspect_camera(path: Path, options: Options) -> Finding:
    """Describe a camera file; InputError if it is not valid."""
    intrinsics = read_intrinsics(path, rectified=options.rectified, side=options.side)
    notes = list(intrinsics.notes)
    remarks: tuple[str, ...] = ()
    distorted = intrinsics.model == "equidistant" or any(intrinsics.distortion)
    if intrinsics.size is None:
        size = "image size not stated"
        notes.append("without a stated image size, that of the masks or images is taken")
    else:
        size = f"{intrinsics.size[0]} x {intrinsics.size[1]} px"
        remarks = intrinsics.camera(path, intrinsics.size).remarks
    if not options.rectified and "ROS" in intrinsics.kind:
        notes.append("images are taken for raw ones unless --rectified says otherwise")
    if "stereo" in intrinsics.kind or "camchain" in intrinsics.kind:
        notes.append("the left camera is taken unless --side says otherwise")
    lens = f"{intrinsics.model} {' '.join(f'{c:.6g}' for c in intrinsics.distortion)}" if distorted else "no distortion"
    read = asdict(intrinsics)
    del read["kind"], read["notes"], read["ratio"]
    return Finding(
        "camera",
        (
            intrinsics.kind,
            f"{size}, focal lengths {intrinsics.fx:.3f} and {intrinsics.fy:.3f} px, "
            f"principal point {intrinsics.cx:.3f}, {intrinsics.cy:.3f}",
            lens,
            *remarks,
        ),
        {"form": intrinsics.kind, **read, "remarks": list(remarks)},
        tuple(notes),
    )
