"""Text output of a result, in millimetres and degrees."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line

if TYPE_CHECKING:
    from dvrk_cmaes.results.result import Result


def describe(result: Result, written: Sequence[Path] = ()) -> Iterator[Line]:
    """Yield the lines of a result: accuracy, status, reasons, pose, joints, fit, alternatives and the files written."""
    accuracy = "" if result.expected_error is None else f"{result.expected_error.in_words}, "
    yield Line(f"{result.frame}: " * bool(result.frame) + accuracy + result.status, STATUS_STYLES[result.status])
    for reason in result.reasons:
        yield Line(f"  {reason}", STATUS_STYLES[result.status].removeprefix("bold "))
    for left_out in result.unused:
        yield Line(f"  not used: {left_out}")
    if result.camera_from_root is not None:
        yield from _pose(result)
    yield from _tips(result)
    yield from _joints(result)
    if result.quality is not None:
        q = result.quality
        yield Line("fit", "bold")
        yield Line(f"  IoU {q.iou:.3f}, contour {q.contour_px_median:.1f} px median, {q.contour_px_95:.1f} px at 95 %")
        yield Line(f"  {100 * q.steady_share:.0f} % of the contour is off in stretches (shadows, cut highlights)")
    if result.mode_probability is not None:
        yield Line(f"  in the right mode with a probability of {result.mode_probability:.2f}")
    within = result.config.get("trust", {}).get("tip_mm")
    if result.tip_probability is not None and within is not None:
        yield Line(f"  tips within {within:g} mm with a probability of {result.tip_probability:.2f}")
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
    """Yield the lines of the root's pose with standard deviations, and of the base's pose if it is known."""
    import numpy as np

    from dvrk_cmaes.geometry import log_rotation

    for title, pose, covariance in (
        (result.root_link, result.camera_from_root, result.covariance_in_camera()),
        ("arm's base", result.camera_from_base, None),
    ):
        if pose is None:
            continue
        axis_angle = [math.degrees(angle) for angle in log_rotation(pose[:3, :3])]
        along = about = ""
        if covariance is not None:
            std = np.sqrt(np.diag(covariance))
            along, about = f"   std {_triple(1e3 * std[:3])}", f"   std {_triple(np.degrees(std[3:6]))}"
        yield Line(f"{title} in the camera (x right, y down, z forward)", "bold")
        yield Line(f"  position, mm    {_triple(1e3 * pose[:3, 3], 9)}{along}")
        yield Line(f"  axis-angle, deg {_triple(axis_angle, 9)}{about}")


def _tips(result: Result) -> Iterator[Line]:
    """Yield the tips: position in the camera, standard deviations along its axes, pixel."""
    if result.tips:
        yield Line("tips in the camera", "bold")
    for k, tip in enumerate(result.tips):
        name = "tip" if len(result.tips) == 1 else f"jaw_{k + 1}"
        axes = None if result.expected_error is None else result.expected_error.tip_axes_mm.get(name)
        std = "" if axes is None else f"   std {_triple(axes)}"
        pixel = "" if not result.tips_px else f", pixel {result.tips_px[k][0]:.1f} {result.tips_px[k][1]:.1f}"
        yield Line(f"  {name + ', mm':<15} {_triple(1e3 * tip, 9)}{std}{pixel}")


def _triple(values: Iterable[float], width: int = 0) -> str:
    """Format numbers with two decimals, each at least ``width`` characters wide."""
    return " ".join(f"{value:{width}.2f}" for value in values)


def _joints(result: Result) -> Iterator[Line]:
    """Yield the table of the joints: values found, standard deviations and readings."""
    if not result.joints:
        return
    yield Line("joints, deg         found      std     read  found - read", "bold")
    for name, value in result.joints.items():
        std, read = (result.std_joints_deg or {}).get(name), result.readings.get(name)
        found = math.degrees(value)
        std_text = "-" if std is None else f"{std:.2f}"
        read_text, difference = (
            ("-", "-") if read is None else (f"{math.degrees(read):.2f}", f"{found - math.degrees(read):+z.2f}")
        )
        yield Line(f"  {name:<15s} {found:>8.2f} {std_text:>8s} {read_text:>8s} {difference:>13s}")
