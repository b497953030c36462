"""A result in words and numbers, for people: millimetres and degrees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line

if TYPE_CHECKING:
    from dvrk_cmaes.results.result import Result


def describe(result: Result, written: Sequence[Path] = ()) -> Iterator[Line]:
    """Lines that say what was found, how far to trust it, and where it was written."""
    heading = f"{result.frame}: {result.status}" if result.frame else result.status
    yield Line(heading, STATUS_STYLES[result.status])
    for reason in result.reasons:
        yield Line(f"  {reason}", STATUS_STYLES[result.status].removeprefix("bold "))
    for left_out in result.unused:
        yield Line(f"  not used: {left_out}")
    if result.camera_from_root is not None:
        yield from _pose(result)
    yield from _joints(result)
    if result.quality is not None:
        q = result.quality
        yield Line("fit", "bold")
        yield Line(f"  IoU {q.iou:.3f}, contour {q.contour_px_median:.1f} px median, {q.contour_px_95:.1f} px at 95 %")
    if result.alternatives:
        yield Line("alternatives", "bold")
    for other in result.alternatives:
        off = other.reading_distance_deg
        distance = "" if off is None else f", {off:.1f} deg rms from the readings"
        joints = ", ".join(f"{name} {math.degrees(value):.1f}" for name, value in other.joints.items())
        yield Line(f"  {other.relation}: IoU {other.iou:.3f}{distance} ({joints} deg)")
    yield Line(f"{result.seconds:.2f} s, {result.evaluations} silhouettes")
    for path in written:
        yield Line(f"written: {path}")


def _pose(result: Result) -> Iterator[Line]:
    """Position and rotation with their standard deviations, and the base's where it is known."""
    from dvrk_cmaes.geometry import log_rotation

    for title, pose, std_t, std_r in (
        (result.root_link, result.camera_from_root, result.std_translation_mm, result.std_rotation_deg),
        ("arm's base", result.camera_from_base, None, None),
    ):
        if pose is None:
            continue
        turn = [math.degrees(angle) for angle in log_rotation(pose[:3, :3])]
        spread_t = "" if std_t is None else f"   std {_triple(std_t)} along its own axes"
        spread_r = "" if std_r is None else f"   std {_triple(std_r)} about its own axes"
        yield Line(f"{title} in the camera (x right, y down, z forward)", "bold")
        yield Line(f"  position, mm    {_triple(1e3 * pose[:3, 3], 9)}{spread_t}")
        yield Line(f"  axis-angle, deg {_triple(turn, 9)}{spread_r}")


def _triple(values: Iterable[float], width: int = 0) -> str:
    return " ".join(f"{value:{width}.2f}" for value in values)


def _joints(result: Result) -> Iterator[Line]:
    """Joints as found and as read."""
    if not result.joints:
        return
    yield Line("joints, deg         found      std     read  found - read", "bold")
    for name, value in result.joints.items():
        std, read = (result.std_joints_deg or {}).get(name), result.readings.get(name)
        found = math.degrees(value)
        spread = "-" if std is None else f"{std:.2f}"
        told, change = (
            ("-", "-") if read is None else (f"{math.degrees(read):.2f}", f"{found - math.degrees(read):+.2f}")
        )
        yield Line(f"  {name:<15s} {found:>8.2f} {spread:>8s} {told:>8s} {change:>13s}")
