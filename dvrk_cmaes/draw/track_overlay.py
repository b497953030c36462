"""Pictures of a followed recording, its frames with the contours of mask and pose; and what is projected in overlays.

These are an instrument's shaft edges and skeleton as lines in an image, clipped in front of the camera.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.canvas import (
    AXES,
    DARK,
    GREEN,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    WHITE,
    YELLOW,
    Canvas,
    Colour,
    beside,
    strip,
)
from dvrk_cmaes.draw.panels import STATUS
from dvrk_cmaes.evidence.shaft_edges import ShaftEdges
from dvrk_cmaes.geometry import Bool, Float64, Image, apply, project_cylinder
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.results.tracked import TrackView

_ARMS: tuple[Colour, ...] = (SKY_BLUE, ORANGE, GREEN, PURPLE)  # in their order; the fifth has that of the first again
_FAINT = 0.25  # brightness of the mask where there is no image
_TINT = 0.35  # of an arm's colour within its tool
_MASK_LINES, _LINES = 640, 320  # widths of a line in that of the picture: 1 and 2 px at 640 px, 2 and 4 px at 1280
_SIZE = 0.45  # of the letters


def draw_track(views: Sequence[TrackView], *, frame: str, status: str, reasons: Sequence[str]) -> Image:
    """Draw the views beside each other, and a strip with the status, (H, W, 3) BGR."""
    drawn = draw_outlines(views)
    text = f"{frame}  {status}" + (f": {reasons[0]}" if reasons else "")
    _write(drawn, [(text, STATUS[status])])
    return drawn


def draw_outlines(views: Sequence[TrackView]) -> Image:
    """Draw mask (yellow, thin), silhouette (blue), axes (red, green, blue) and tips in each view, (H, W, 3) BGR."""
    return beside([_outlined(view) for view in views])


def draw_track_of_arms(
    views: Sequence[Mapping[str, TrackView]], *, frame: str, statuses: Mapping[str, str], order: Sequence[str]
) -> Image:
    """Draw the tools of several arms, each in its colour, and a strip with the status of each, (H, W, 3) BGR.

    ``views`` have the arms' silhouettes, images and masks by arm; ``order`` are the arms from the farthest to the
    nearest, which is drawn over the others.
    """
    colours, drawn = {arm: _ARMS[k % len(_ARMS)] for k, arm in enumerate(statuses)}, []
    for view in views:
        masks = [tool.mask for tool in view.values() if tool.mask is not None]
        first = next(iter(view.values()))
        picture = _background(first.image, np.logical_or.reduce(masks) if masks else None, first.size)
        for arm in order:
            silhouette = view[arm].silhouette
            if silhouette is not None:
                mixed = (1 - _TINT) * picture[silhouette] + _TINT * np.array(colours[arm])
                picture[silhouette] = np.rint(mixed).astype(np.uint8)
                _contour(picture, silhouette, colours[arm], _LINES)
        drawn.append(picture)
    whole = beside(drawn)
    _write(whole, [(frame, YELLOW), *((f"{arm} {status}", colours[arm]) for arm, status in statuses.items())])
    return whole


def _outlined(view: TrackView) -> Image:
    """Draw the contour of a view's mask, and over it that of the silhouette, the root's axes and the jaws' tips."""
    drawn = _background(view.image, view.mask, view.size)
    for region, colour, lines in ((view.mask, YELLOW, _MASK_LINES), (view.silhouette, SKY_BLUE, _LINES)):
        if region is not None:
            _contour(drawn, region, colour, lines)
    canvas = Canvas(drawn, max(1.0, drawn.shape[1] / 640))
    if view.axes is not None:
        for (_, colour), end in zip(AXES, view.axes[1:], strict=True):
            canvas.line(np.stack([view.axes[0], end]), colour)
    for tip in () if view.tips is None else view.tips:
        canvas.ring(tip, WHITE, radius=4.0)
    return drawn


def _background(image: Image | None, mask: Bool | None, size: tuple[int, int]) -> Image:
    """Return a copy of an image in a size, or without one a dark picture with the mask."""
    if image is not None:
        same = image.shape[1::-1] == size
        return image.copy() if same else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    drawn = np.full((*size[::-1], 3), DARK, dtype=np.uint8)
    if mask is not None:
        drawn[mask] = round(_FAINT * 255)
    return drawn


def _contour(picture: Image, region: Bool, colour: Colour, lines: int) -> None:
    """Draw the contours of a region (H, W) into a picture whose width is ``lines`` times that of the lines."""
    thickness = max(1, round(picture.shape[1] / lines))
    contours, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(picture, contours, -1, colour, thickness, cv2.LINE_AA)


def _write(picture: Image, texts: Sequence[tuple[str, Colour]]) -> None:
    """Write texts, each in a colour, one after the other on a dark strip over the top of a picture."""
    drawn = strip(picture.shape[1], max(1.0, picture.shape[1] / 640), [texts], size=_SIZE)
    picture[: len(drawn)] = drawn[: len(picture)]


_NEAREST = 0.005  # m, least depth of a point that is drawn; instruments are farther away
_AXIS = 0.006  # m, length of drawn axes
_SAMPLES = 300  # points along an edge, which is curved by lens distortion


def project_visible(camera: Camera, points: Float64) -> Float64:
    """Project points (N, 3), m, in the camera's frame to pixels (N, 2); NaN for points with a depth below 5 mm."""
    pixels = np.full((len(points), 2), np.nan)
    before = points[:, 2] > _NEAREST
    pixels[before] = camera.project(points[before])
    return pixels


def projected_axes(camera: Camera, pose: Float64) -> Float64:
    """Project the origin of a frame with a pose (4, 4), m, and the ends of its axes, 6 mm long: (4, 2) px."""
    return project_visible(camera, apply(pose, np.concatenate([np.zeros((1, 3)), _AXIS * np.eye(3)])))


def projected_edges(instrument: Instrument, camera_from_root: Float64, camera: Camera) -> list[Float64]:
    """Project both edges of the shaft's straight part to the image.

    Each edge is the line in which a plane through the camera's centre touches the cylinder.

    Returns
    -------
    list of (N, 2)
        Pixels of the two edges; empty without a shaft, or if the camera's centre is inside the cylinder.
    """
    shaft = instrument.shaft
    if shaft is None:
        return []
    point = apply(camera_from_root, shaft.point[None])[0]
    direction = camera_from_root[:3, :3] @ shaft.direction
    edges = []
    for normal in project_cylinder(point, direction, shaft.radius):
        if not np.isfinite(normal).all():
            return []  # the camera's centre is inside the cylinder
        outward = normal / np.linalg.norm(normal) * (-1.0 if normal @ point > 0 else 1.0)
        along = np.linspace(shaft.distal_end, shaft.proximal_end, _SAMPLES)
        edges.append(project_visible(camera, point + shaft.radius * outward + along[:, None] * direction))
    return edges


def found_edges(edges: ShaftEdges, camera: Camera) -> list[Float64]:
    """Return both edges found in a mask, (N, 2) px each, between their visible ends; ``camera`` is that of the mask."""
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    share = np.linspace(0, 1, _SAMPLES)[:, None]
    return [
        camera.distort((start + share * (end - start) - centre) / focal) * focal + centre for start, end in edges.ends
    ]


def skeleton_lines(
    instrument: Instrument, camera_from_root: Float64, joints: Float64, camera: Camera
) -> tuple[Float64, Float64]:
    """Project the skeleton: a polyline (N, 2) px from the shaft to the wrist, and the jaw tips (0 or 2, 2) px."""
    pixels = project_visible(camera, apply(camera_from_root, instrument.skeleton(joints)))
    count = len(pixels) - len(instrument.jaw_tips)
    return pixels[:count], pixels[count:]
