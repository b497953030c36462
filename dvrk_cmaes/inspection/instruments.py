"""Inspection of instruments, meshes, and the dVRK's descriptions of tools and arms."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dvrk_cmaes.inspection.finding import Finding, Options, unit_of
from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.instrument.dvrk_description import read_kinematics, read_tool
from dvrk_cmaes.instrument.meshes import read_mesh


def inspect_urdf(path: Path, options: Options) -> Finding:
    """Describe an instrument; InputError if it cannot be loaded."""
    instrument = load_instrument(path, package_paths=options.package_paths)
    faces = {link.name: len(link.faces) for link in instrument.links}
    shaft = instrument.shaft
    limits = {
        name: (float(low), float(high))
        for name, (low, high) in zip(instrument.joint_names, instrument.limits, strict=True)
    }
    shaft_text = "no straight shaft found"
    if shaft is not None:
        shaft_text = f"shaft of {1e3 * shaft.radius:.2f} mm radius, straight over {1e3 * shaft.length:.0f} mm"
    return Finding(
        "instrument (URDF)",
        (
            f"{instrument.name}, pose sought of {instrument.root_link}",
            f"links with meshes: {', '.join(f'{name} ({count} triangles)' for name, count in faces.items())}",
            *_limits(limits),
            shaft_text,
            "a pair of jaws" if instrument.jaw_tips else "no pair of jaws",
            "looks alike in its mirror twin" if instrument.has_twin else "does not look alike in its mirror twin",
        ),
        {
            "name": instrument.name,
            "root_link": instrument.root_link,
            "triangles": faces,
            "limits": limits,
            "shaft_radius": instrument.shaft_radius,
            "jaws": bool(instrument.jaw_tips),
            "has_twin": instrument.has_twin,
        },
        ("limits are the URDF's unless --tool gives others",),
    )


def inspect_mesh(path: Path) -> Finding:
    """Describe a mesh; InputError if it is not valid."""
    vertices, faces = read_mesh(path)
    extent = np.ptp(vertices, axis=0)
    sides = " x ".join(f"{1e3 * side:.2f}" for side in extent)
    return Finding(
        "mesh",
        (f"{len(faces)} triangles, {len(vertices)} vertices", f"{sides} mm, if its unit is the metre"),
        {"triangles": len(faces), "vertices": len(vertices), "extent": extent.tolist()},
        ("meshes have no unit but COLLADA's: a URDF's scale makes them metres",),
    )


def inspect_tool(path: Path) -> Finding:
    """Describe a dVRK tool description; InputError if it is not valid."""
    tool = read_tool(path)
    return Finding(
        "dVRK tool",
        (
            f"wrist {1e3 * tool.roll_offset:.1f} mm beyond the frame of the insertion (D of roll), "
            f"{1e3 * tool.wrist_length:.2f} mm between its axes",
            *_limits(tool.limits),
        ),
        {"roll_offset": tool.roll_offset, "wrist_length": tool.wrist_length, "limits": dict(tool.limits)},
    )


def inspect_kinematics(path: Path) -> Finding:
    """Describe a dVRK kinematic description; InputError if it is not valid."""
    arm = read_kinematics(path)
    which = "neither the Classic's nor the Si's" if arm.arm is None else f"that of --arm {arm.arm}"
    return Finding(
        "dVRK kinematics",
        (f"insertion offset {1e3 * arm.insertion_offset:.1f} mm, {which}", *_limits(arm.limits)),
        {"arm": arm.arm, "insertion_offset": arm.insertion_offset, "limits": dict(arm.limits)},
    )


def _limits(limits: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Format the limits of joints, in mm or degrees."""
    texts = []
    for name, (low, high) in limits.items():
        scale, unit = unit_of(name)
        texts.append(f"{name} from {scale * low:.1f} to {scale * high:.1f} {unit}")
    return (f"limits: {', '.join(texts)}",) if texts else ("no joints",)
