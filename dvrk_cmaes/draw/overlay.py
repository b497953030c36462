"""Overlay of a result over its frame.

On the image, or on a dark background, it shows the contours of the mask and of the silhouette, the pixels in only one
of the two, the stretches of the mask's contour that are off together, the shaft's edges and the jaw tips as found and
as projected, the skeleton and the root's axes. In the corner with the least of the mask the tips are enlarged. A strip
above gives the expected error, the status and the reasons; a strip below gives the legend, and the joints with their
readings.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.canvas import AXES, DARK, GREY, Canvas, Colour, plain
from dvrk_cmaes.draw.panels import FOUND, MASK, PROJECTED, SILHOUETTE, SKELETON, STEADY, footer, header
from dvrk_cmaes.draw.track_overlay import found_edges, projected_axes, projected_edges, skeleton_lines
from dvrk_cmaes.evidence.gather import Evidence, gather_evidence
from dvrk_cmaes.evidence.outline_noise import distances_to
from dvrk_cmaes.evidence.quantiles import steady_stretches
from dvrk_cmaes.geometry import Bool, Float64
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body, Renderer

SMALLEST, _LARGEST = 1000, 2000  # px, width of the drawing
_FAINT = 0.22  # brightness of the mask where there is no image, 0 to 1
_INSET = 0.3  # side of the enlarged tips in the drawing's height
_SHOWN = 0.1  # and of what they show, at least, in that of the frame


def draw_overlay(
    result: Result,
    mask: Bool,
    camera: Camera,
    body: Body,
    *,
    image: NDArray[np.uint8] | None = None,
    ignore: Bool | None = None,
    keypoints: Float64 | None = None,
    evidence: Evidence | None = None,
) -> NDArray[np.uint8]:
    """Draw a result over its frame.

    Parameters
    ----------
    result
        The estimate; without a pose only the mask is drawn.
    mask
        (H, W) bool, the instrument.
    camera
        The camera, of the mask's size.
    body
        The instrument, prepared for rendering.
    image
        (H', W', 3) uint8 BGR with the mask's aspect ratio, the drawing's background.
    ignore
        (H, W) bool, pixels that are not compared; hatched.
    keypoints
        (2, 2) px, the jaw tips, if they were given.
    evidence
        Evidence found in the mask; by default gathered from mask, ``ignore`` and ``keypoints``.

    Returns
    -------
    (h, w, 3) uint8, BGR
        The frame between two strips of text. Frames narrower than 1000 px are enlarged by a whole factor, those wider
        than 2000 px reduced.
    """
    if evidence is None:
        evidence = gather_evidence(mask, camera, body.instrument, ignore=ignore, keypoints=keypoints, seed=result.seed)
    frame = FrameCanvas.of(mask, camera, image)
    canvas = frame.canvas
    if ignore is not None:
        _hatch(canvas, frame.enlarged(ignore))
    absent: set[Colour] = set()
    if result.camera_from_root is None:
        canvas.outline(frame.enlarged(mask), MASK)
    else:
        absent = _draw_pose(frame, result, mask, body, evidence, result.camera_from_root, image)
    return _between_strips(result, canvas, absent)


def draw_failed(result: Result, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draw a frame without a pose: its image or mask, (H, W, 3) BGR, and the reasons in the strip above it."""
    return _between_strips(result, _canvas(_size(picture.shape[:2]), picture))


def _between_strips(result: Result, canvas: Canvas, absent: Container[Colour] = ()) -> NDArray[np.uint8]:
    width = canvas.image.shape[1]
    below = footer(result, width, canvas.unit, absent)
    return np.concatenate([header(result, width, canvas.unit), canvas.image, below])


def _canvas(size: tuple[int, int], image: NDArray[np.uint8]) -> Canvas:
    """Return a canvas of a size, (width, height) px, with an image (h, w, 3), enlarged or reduced."""
    way = cv2.INTER_AREA if image.shape[1] > size[0] else cv2.INTER_CUBIC
    return Canvas(np.ascontiguousarray(cv2.resize(image, size, interpolation=way), dtype=np.uint8), size[0] / 1280)


def _size(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return width and height of the drawing of a frame of a shape (H, W)."""
    height, width = shape
    scale = float(np.ceil(SMALLEST / width)) if width < SMALLEST else min(1.0, _LARGEST / width)
    return max(round(width * scale), 1), max(round(height * scale), 1)


@dataclass(frozen=True, eq=False)
class FrameCanvas:
    """The canvas, the camera of the mask, and the canvas's pixels per pixel of the mask."""

    canvas: Canvas
    camera: Camera
    scale: float

    @staticmethod
    def of(
        mask: Bool, camera: Camera, image: NDArray[np.uint8] | None, size: tuple[int, int] | None = None
    ) -> FrameCanvas:
        """Make the canvas of a frame, of a size in px: its image (H', W', 3) BGR, or its mask (H, W), faintly."""
        size = _size(mask.shape) if size is None else size
        if image is None:
            small = plain(mask.shape[0], mask.shape[1], DARK)
            small.reshape(-1, 3)[np.flatnonzero(mask)] = round(255 * _FAINT)
            drawn = cv2.resize(small, size, interpolation=cv2.INTER_NEAREST)
            canvas = Canvas(np.asarray(drawn, dtype=np.uint8), size[0] / 1280)
        else:
            canvas = _canvas(size, image)
        return FrameCanvas(canvas, camera, size[0] / mask.shape[1])

    def at(self, pixels: Float64) -> Float64:
        """Convert pixels (N, 2) of the mask to pixels of the canvas."""
        return np.asarray((pixels + 0.5) * self.scale - 0.5)

    def enlarged(self, mask: Bool) -> Bool:
        """Resize a mask (H, W) to the canvas with a smoothed outline."""
        height, width = self.canvas.image.shape[:2]
        smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7)
        return np.asarray(cv2.resize(smooth, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5)

    def silhouette(self, body: Body, pose: Float64, joints: Float64) -> Bool:
        """Render the silhouette of a pose (4, 4) and joints (J,) on the canvas, (h, w)."""
        height, width = self.canvas.image.shape[:2]
        renderer = Renderer(body, self.camera.scaled(width, height), threads=1)
        return np.asarray(renderer.masks(pose[None], joints[None])[0])

    def draw_skeleton(self, instrument: Instrument, pose: Float64, joints: Float64) -> tuple[Float64, Float64]:
        """Draw the skeleton of a pose (4, 4) and joints (J,), and return it as `skeleton_lines`."""
        line, tips = skeleton_lines(instrument, pose, joints, self.camera)
        for points in (line, *(np.stack([line[-1], tip]) for tip in tips)):
            self.canvas.line(self.at(points), SKELETON, width=1.2)
        return line, tips


def _draw_pose(
    frame: FrameCanvas,
    result: Result,
    mask: Bool,
    body: Body,
    evidence: Evidence,
    pose: Float64,
    image: NDArray[np.uint8] | None,
) -> set[Colour]:
    """Draw a pose, and return the colours of what there is none of: stretches that are off, edges and tips found."""
    canvas, camera, instrument = frame.canvas, frame.camera, body.instrument
    joints = np.array([result.joints[name] for name in instrument.joint_names])
    silhouette = frame.silhouette(body, pose, joints)
    seen = frame.enlarged(mask)
    canvas.tint(seen & ~silhouette, MASK, 0.5)
    canvas.tint(silhouette & ~seen, SILHOUETTE, 0.5)
    canvas.outline(seen, MASK)
    canvas.outline(silhouette, SILHOUETTE)
    stretches = _steady_stretches(evidence, silhouette, frame)
    for stretch in stretches:
        canvas.line(stretch, STEADY, width=3.0)

    for edge in projected_edges(instrument, pose, camera):
        canvas.line(frame.at(edge), PROJECTED, width=2.0, dash=(14, 26), phase=20)
    if evidence.shaft_edges:
        for edge in found_edges(evidence.shaft_edges[0], camera):
            canvas.line(frame.at(edge), FOUND, width=2.0, dash=(14, 26))

    line, tips = frame.draw_skeleton(instrument, pose, joints)
    for tip in tips:
        canvas.ring(frame.at(tip), PROJECTED)
    for tip in [] if evidence.tips is None else evidence.tips:
        canvas.cross(frame.at(tip), FOUND)
    _axes(frame, pose)
    if len(tips):
        _draw_enlarged(frame, mask, image, body, (pose, joints), np.concatenate([tips, line[-1:]]), seen)
    found = evidence.shaft_edges or evidence.tips is not None
    return {colour for colour, drawn in ((STEADY, stretches), (FOUND, found)) if not drawn}


def _draw_enlarged(
    frame: FrameCanvas,
    mask: Bool,
    image: NDArray[np.uint8] | None,
    body: Body,
    posed: tuple[Float64, Float64],
    ends: Float64,
    seen: Bool,
) -> None:
    """Draw the outlines about the tips, enlarged, in the corner with the least of the mask; nothing out of view.

    ``posed`` are the pose (4, 4) and joints (J,), ``ends`` (N, 2) px the tips and, last, the end of the wrist;
    ``seen`` is the mask on the canvas, (h, w).
    """
    (height, width), (tall, wide) = mask.shape, frame.canvas.image.shape[:2]
    if not ((ends >= 0) & (ends < (width, height))).all():
        return
    side = min(round(max(_SHOWN * height, 1.4 * float(np.ptp(ends, axis=0).max()))), height, width)
    middle = (ends.min(axis=0) + ends.max(axis=0)) / 2
    left, top = (
        round(float(np.clip(at - side / 2, 0, most - side))) for at, most in zip(middle, mask.shape[::-1], strict=True)
    )
    if image is not None:
        whole = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        image = np.asarray(whole[top : top + side, left : left + side], np.uint8)
    across = round(_INSET * tall)
    window = frame.camera.cropped(left, top, side, side)
    shown = mask[top : top + side, left : left + side]
    near = FrameCanvas.of(shown, window, image, (across, across))
    near.canvas.unit = frame.canvas.unit
    near.canvas.outline(near.enlarged(shown), MASK)
    near.canvas.outline(near.silhouette(body, *posed), SILHOUETTE)
    for tip in ends[:-1]:
        near.canvas.ring(near.at(tip - (left, top)), PROJECTED)
    corners = [(y, x) for y in (0, tall - across) for x in (0, wide - across)]
    y, x = min(corners, key=lambda corner: int(seen[corner[0] :, corner[1] :][:across, :across].sum()))
    frame.canvas.image[y : y + across, x : x + across] = near.canvas.image
    cv2.rectangle(frame.canvas.image, (x, y), (x + across - 1, y + across - 1), GREY, 2)


def _steady_stretches(evidence: Evidence, silhouette: Bool, frame: FrameCanvas) -> list[Float64]:
    """Return the stretches of the mask's contour that are off together, each (N, 2) px of the canvas.

    ``silhouette`` (h, w) has the canvas's size. Distances are measured at the mask's size, as for the result.
    """
    contour = evidence.contour.pixels
    size = frame.camera.width, frame.camera.height
    silhouette = cv2.resize(silhouette.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    if silhouette.all() or not silhouette.any():
        return []
    distances = distances_to(silhouette, contour)
    index = np.flatnonzero(steady_stretches(contour, distances))
    breaks = np.flatnonzero((np.diff(index) > 1) | (np.diff(distances[index] > 0) != 0)) + 1
    return [frame.at(contour[part]) for part in np.split(index, breaks) if len(part)]


def _axes(frame: FrameCanvas, pose: Float64) -> None:
    """Draw the root's axes, 6 mm long, and their names."""
    origin, *tips = frame.at(projected_axes(frame.camera, pose))
    for (name, colour), tip in zip(AXES, tips, strict=True):
        frame.canvas.line(np.stack([origin, tip]), colour, width=3.0)
        away = tip - origin
        length = float(np.linalg.norm(away))
        if np.isfinite(length):
            place = tip + away / max(length, 1e-9) * 12 * frame.canvas.unit
            frame.canvas.text(name, (place[0] - 5 * frame.canvas.unit, place[1]), colour, size=0.6, rim=True)


def _hatch(canvas: Canvas, where: Bool) -> None:
    """Hatch the pixels where a mask (h, w) is True."""
    v, u = np.indices(where.shape)
    period = max(4, round(14 * canvas.unit))
    canvas.tint(where & ((u + v) % period < max(1, period // 6)), GREY, 0.8)
