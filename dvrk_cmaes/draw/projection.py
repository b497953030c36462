"""Projection of an instrument's shaft edges and skeleton to lines in an image, clipped in front of the camera."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.shaft_edges import ShaftEdges
from dvrk_cmaes.geometry import Float64, apply, project_cylinder
from dvrk_cmaes.instrument import Instrument

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
