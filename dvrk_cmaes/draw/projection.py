"""Where parts of an instrument appear in an image: lines in pixels, cut off before the camera's plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evidence.cylinder_view import project_cylinder
from dvrk_cmaes.evidence.shaft_edges import ShaftEdges
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]

_NEAREST = 0.005  # m before the camera; nearer than any instrument can be seen
_SAMPLES = 300  # points along an edge, which a lens may bend


def project_visible(camera: Camera, points: Float64) -> Float64:
    """Project points (N, 3), m, in the camera's frame to pixels (N, 2); not a number where they are not before it."""
    pixels = np.full((len(points), 2), np.nan)
    before = points[:, 2] > _NEAREST
    pixels[before] = camera.project(points[before])
    return pixels


def projected_edges(instrument: Instrument, camera_from_root: Float64, camera: Camera) -> list[Float64]:
    """Both edges of the shaft's straight part in the image, (N, 2) px each; none where there is no shaft to be seen.

    Each is where the plane through the eye that touches the cylinder does so: a straight line in space.
    """
    shaft = instrument.shaft
    if shaft is None:
        return []
    point = apply(camera_from_root, shaft.point[None])[0]
    direction = camera_from_root[:3, :3] @ shaft.direction
    edges = []
    for normal in project_cylinder(point, direction, shaft.radius):
        if not np.isfinite(normal).all():
            return []  # The eye is inside the cylinder.
        outward = normal / np.linalg.norm(normal) * (-1.0 if normal @ point > 0 else 1.0)
        along = np.linspace(shaft.distal_end, shaft.proximal_end, _SAMPLES)
        edges.append(project_visible(camera, point + shaft.radius * outward + along[:, None] * direction))
    return edges


def found_edges(edges: ShaftEdges, camera: Camera) -> list[Float64]:
    """Both edges found in a mask, (N, 2) px each, between the ends where they were seen; ``camera`` is the mask's."""
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    share = np.linspace(0, 1, _SAMPLES)[:, None]
    return [
        camera.distort((start + share * (end - start) - centre) / focal) * focal + centre for start, end in edges.ends
    ]


def skeleton_lines(
    instrument: Instrument, camera_from_root: Float64, joints: Float64, camera: Camera
) -> tuple[Float64, Float64]:
    """Skeleton in the image, px: a polyline (N, 2) from the shaft to the wrist, and the jaw tips (0 or 2, 2)."""
    pixels = project_visible(camera, apply(camera_from_root, instrument.skeleton(joints)))
    count = len(pixels) - len(instrument.jaw_tips)
    return pixels[:count], pixels[count:]
