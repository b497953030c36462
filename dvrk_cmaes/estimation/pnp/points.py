"""Pose from point correspondences by OpenCV's perspective-n-point (PnP) solvers, which initialise earlier trackers.

The 3-D points of the instrument are computed from the joint readings, without correction; errors of the readings
therefore cause errors of the pose. Pixels are undistorted first, and the solvers use a pinhole camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Float64, Indices, apply, exp_rotation, transform

Solver = Literal["sqpnp", "ransac"]
LEAST_POINTS: Final = 4
"""Least number of points for a unique solution."""
_RANSAC_PIXELS: Final = 8.0
_RANSAC_ITERATIONS: Final = 300


@dataclass(frozen=True, eq=False)
class PointPose:
    """A pose from points.

    camera_from_root : (4, 4).
    error_px : root mean square reprojection error, px.
    used : number of points that the pose was computed from.
    """

    camera_from_root: Float64
    error_px: float
    used: int


def undistort(camera: Camera, pixels: Float64) -> Float64:
    """Undistort pixels (N, 2): return where a pinhole camera of the same matrix would see them."""
    return np.asarray(camera.normalise(pixels) * [camera.fx, camera.fy] + [camera.cx, camera.cy])


def solve_points(camera: Camera, pixels: Float64, points: Float64, solver: Solver = "sqpnp") -> PointPose | str:
    """Find the pose in which points (N, 3) of the root's frame, m, appear at pixels (N, 2).

    Returns a message instead of a pose if there are too few points or the solver finds no pose.
    """
    if len(points) < LEAST_POINTS:
        return f"{len(points)} of the points that are known were seen, at least {LEAST_POINTS} are needed"
    seen, K, no_lens = undistort(camera, pixels), camera.matrix, np.zeros(4)
    used: Indices = np.arange(len(points), dtype=np.intp)
    try:
        if solver == "ransac":
            solved, turn, shift, inliers = cv2.solvePnPRansac(
                points,
                seen,
                K,
                no_lens,
                iterationsCount=_RANSAC_ITERATIONS,
                reprojectionError=_RANSAC_PIXELS,
                flags=cv2.SOLVEPNP_ITERATIVE,
            )
            used = np.zeros(0, dtype=np.intp) if inliers is None else np.asarray(inliers, dtype=np.intp).ravel()
        else:
            solved, turn, shift = cv2.solvePnP(points, seen, K, no_lens, flags=cv2.SOLVEPNP_SQPNP)
            if solved:
                turn, shift = cv2.solvePnPRefineLM(points, seen, K, no_lens, turn, shift)
    except cv2.error as error:
        return f"OpenCV's solver refused the points ({error.err or error.code})"
    if not solved or len(used) < LEAST_POINTS:
        return "OpenCV's solver found no pose that the points agree on"
    pose = transform(exp_rotation(np.ravel(turn)), np.ravel(shift))
    if not np.isfinite(pose).all():
        return "OpenCV's solver found no finite pose"
    apart = reprojection_error(camera, pose, points[used], seen[used])
    if apart is None:
        return "the pose that OpenCV's solver found lies behind the camera"
    return PointPose(pose, apart, len(used))


def reprojection_error(camera: Camera, pose: Float64, points: Float64, seen: Float64) -> float | None:
    """Return the root mean square distance, px, of projected points (N, 3) in a pose (4, 4) from pixels (N, 2).

    The pixels are undistorted. None if a point lies behind the camera.
    """
    placed = apply(pose, points)
    if placed[:, 2].min() <= 0:
        return None
    projected = placed[:, :2] / placed[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return float(np.sqrt(((projected - seen) ** 2).sum(axis=1).mean()))
