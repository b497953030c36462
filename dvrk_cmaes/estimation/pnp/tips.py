"""Pose from two jaw tips and the two edges of the shaft.

The edges and the shaft's radius determine its axis in the camera's frame. The remaining translation along the axis and
rotation about it are determined by the two tips, whose positions in the root's frame are computed from the joint
readings; errors of the readings therefore cause errors of the roll.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import least_squares

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.estimation.pnp.points import PointPose, undistort
from dvrk_cmaes.evidence.shaft_edges import ShaftEdges, shaft_axis
from dvrk_cmaes.geometry import Float64, Posed, frame_along, moved, project_cylinder, rotation_about_z, transform
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.pose.search.objective import keypoint_loss, project_tips

_TURNS: Final = 48  # start angles about the axis
_SLIDES: Final = np.linspace(-0.03, 0.03, 31)  # m, start positions of the root along the axis, relative to the tips
_STARTS: Final = 4  # best starts that are refined
_SCALE: Final = np.array([1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02])  # m, rad: units of the refined variables


def solve_tips(
    camera: Camera, instrument: Instrument, joints: Float64, tips: Float64, edges: ShaftEdges
) -> PointPose | str:
    """Find the pose that minimises the reprojection errors of the jaw tips and of the shaft's edges.

    Parameters
    ----------
    camera
        The camera.
    instrument
        An instrument with a shaft and two jaws.
    joints : (J,)
        Readings, rad; they are not corrected.
    tips : (2, 2)
        Pixels of the tips, in either order.
    edges
        The shaft's two edges.

    Returns
    -------
    PointPose or str
        A message if the instrument has no shaft or no jaws, or if no pose is found.
    """
    shaft = instrument.shaft
    if shaft is None or not instrument.jaw_tips:
        return f"{instrument.name} has no shaft with two jaws"
    seen = undistort(camera, tips)
    pinhole = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    starts = _starts(pinhole, instrument, joints, seen, edges)
    scores = keypoint_loss(project_tips(instrument, pinhole, Posed(starts, np.tile(joints, (len(starts), 1)))), seen)
    solutions: list[tuple[float, Float64]] = []
    for index in np.argsort(scores, kind="stable")[:_STARTS]:
        for pairing in (seen, seen[::-1]):
            start = starts[index]

            def residuals(change: Float64, start: Float64 = start, pairing: Float64 = pairing) -> Float64:
                pose = moved(start, change * _SCALE)
                tip = project_tips(instrument, pinhole, Posed(pose[None], joints[None]))[0]
                return np.concatenate([(tip - pairing).ravel(), _edge_distances(pinhole, instrument, pose, edges)])

            done = least_squares(residuals, np.zeros(6), max_nfev=60)
            solutions.append((float(done.cost), moved(start, done.x * _SCALE)))
    cost, pose = min(solutions, key=lambda solution: solution[0])
    if not np.isfinite(cost) or pose[2, 3] <= 0:
        return "no pose brings tips and edges together"
    measured = 4  # points: two tips with two coordinates each; two ends of two edges, each with one distance
    return PointPose(pose, float(np.sqrt(2 * cost / measured)), measured)


def _starts(camera: Camera, instrument: Instrument, joints: Float64, seen: Float64, edges: ShaftEdges) -> Float64:
    """Return start poses (C, 4, 4) with the shaft on the axis of the edges, on a grid of positions and angles."""
    assert instrument.shaft is not None
    axis, point = shaft_axis(edges.planes, instrument.shaft.radius)
    tips, shaft = (_nearest_on_axis(camera, axis, point, p.mean(axis=0)) for p in (seen, edges.ends.reshape(-1, 2)))
    direction = axis if tips > shaft else -axis
    turn = rotation_about_z(np.linspace(0, 2 * np.pi, _TURNS, endpoint=False))
    origins = point + tips * axis + _SLIDES[:, None] * direction
    return transform((frame_along(direction) @ turn)[None], origins[:, None]).reshape(-1, 4, 4)


def _nearest_on_axis(camera: Camera, axis: Float64, point: Float64, pixel: Float64) -> float:
    """Return the coordinate along an axis, m from ``point`` (3,), of its point nearest to a pixel's ray."""
    ray = np.array([*camera.normalise(pixel), 1.0])
    away = np.cross(ray, np.cross(axis, ray))
    return -float(away @ point) / float(away @ axis)


def _edge_distances(camera: Camera, instrument: Instrument, pose: Float64, edges: ShaftEdges) -> Float64:
    """Return the distances (4,), px, of the seen edges' ends from the projected edges, in the nearer of both pairings.

    Distances that are not finite because the camera is inside the cylinder are 1000 px.
    """
    shaft = instrument.shaft
    assert shaft is not None
    rotation, translation = pose[:3, :3], pose[:3, 3]
    planes = project_cylinder(rotation @ shaft.point + translation, rotation @ shaft.direction, shaft.radius)
    lines = planes @ np.linalg.inv(camera.matrix)
    lines = lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    distances = edges.ends @ lines[:, :2].T + lines[:, 2]  # edge, end, projected line
    straight = distances[[0, 1], :, [0, 1]]
    crossed = distances[[0, 1], :, [1, 0]]
    nearer = straight if np.abs(straight).sum() <= np.abs(crossed).sum() else crossed
    return np.asarray(np.nan_to_num(nearer.ravel(), nan=1e3))
