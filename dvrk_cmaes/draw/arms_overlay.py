"""Overlay of the tools of several arms over their common frame, each in its colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.canvas import DARK, GREEN, ORANGE, PURPLE, SKY_BLUE, WHITE, Canvas, Colour
from dvrk_cmaes.draw.overlay import FrameCanvas
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body

COLOURS: Final[tuple[Colour, ...]] = (SKY_BLUE, ORANGE, GREEN, PURPLE)
"""Colours of the arms, in their order; the fifth has that of the first again."""

_LINE = 26  # px of a canvas 1280 px wide, height of an arm's line of text
_TINT = 0.35


@dataclass(frozen=True, eq=False)
class ArmDrawing:
    """An arm's result in a frame, its prepared instrument, and the colour in which it is drawn."""

    arm: str
    result: Result
    body: Body
    colour: Colour


def arm_colours(arms: Sequence[str]) -> dict[str, Colour]:
    """Return the colour of each arm."""
    return {arm: COLOURS[k % len(COLOURS)] for k, arm in enumerate(arms)}


def draw_arms(
    arms: Sequence[ArmDrawing], mask: Bool, camera: Camera, image: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    """Draw the tools of several arms over one frame.

    Parameters
    ----------
    arms
        The arms; one whose result has no pose is only named above the picture.
    mask
        (H, W) bool, all instruments, which are drawn faintly where there is no image.
    camera
        The camera, of the mask's size.
    image
        (H', W', 3) uint8 BGR with the mask's aspect ratio, the background.

    Returns
    -------
    (h, w, 3) uint8, BGR
        The picture below a line of text for each arm. Where tools overlap, the nearer one covers the other.
    """
    frame = FrameCanvas.of(mask, camera, image)
    posed = [drawing for drawing in arms if drawing.result.camera_from_root is not None]
    for drawing in sorted(posed, key=_distance, reverse=True):
        _draw_arm(frame, drawing)
    strip = Canvas(
        np.full((round(_LINE * len(arms) * frame.canvas.unit) or 1, frame.canvas.image.shape[1], 3), DARK, np.uint8),
        frame.canvas.unit,
    )
    for k, drawing in enumerate(arms):
        middle = (k + 0.5) * _LINE * strip.unit
        strip.text(drawing.arm, (12 * strip.unit, middle), drawing.colour, size=0.6)
        left = 24 * strip.unit + strip.text_width(drawing.arm, 0.6)
        strip.text(_in_words(drawing.result), (left, middle), WHITE, size=0.5)
    return np.concatenate([strip.image, frame.canvas.image])


def _distance(drawing: ArmDrawing) -> float:
    """Distance of the tool's root from the camera, m."""
    assert drawing.result.camera_from_root is not None
    return float(np.linalg.norm(drawing.result.camera_from_root[:3, 3]))


def _in_words(result: Result) -> str:
    """Describe a result in a few words."""
    parts: list[str] = [result.status]
    if result.expected_error is not None:
        parts.append(result.expected_error.in_words)
    return ", ".join([*parts, *result.reasons[:1]])


def _draw_arm(frame: FrameCanvas, drawing: ArmDrawing) -> None:
    """Draw silhouette and skeleton of a tool, and its arm's name beside the root."""
    canvas, instrument, pose = frame.canvas, drawing.body.instrument, drawing.result.camera_from_root
    assert pose is not None
    joints = np.array([drawing.result.joints[name] for name in instrument.joint_names])
    silhouette = frame.silhouette(drawing.body, pose, joints)
    canvas.tint(silhouette, drawing.colour, _TINT)
    canvas.outline(silhouette, drawing.colour)
    line, _ = frame.draw_skeleton(instrument, pose, joints)
    u, v = frame.at(line[-1:])[0]
    if np.isfinite([u, v]).all():
        canvas.text(drawing.arm, (float(u) + 10 * canvas.unit, float(v)), drawing.colour, size=0.7, rim=True)


def drawings(results: Mapping[str, Mapping[str, Result]], bodies: Mapping[str, Body], frame: str) -> list[ArmDrawing]:
    """Return what is to be drawn in a frame, given the results by arm and frame, and the arms' instruments."""
    colours = arm_colours(list(results))
    return [
        ArmDrawing(arm, of_arm[frame], bodies[arm], colours[arm]) for arm, of_arm in results.items() if frame in of_arm
    ]
