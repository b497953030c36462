"""What errors of the camera file and of the instrument's size do to a pose: six parameters, and how a pose follows.

The parameters are relative, so that they are the same for an image of any size and crop: the logarithm of the focal
length, that of fy / fx, the principal point right and down over the focal length, the first radial coefficient, and the
logarithm of the factor on all of the instrument.
An outline that is seen stays where it is in the image, so that a pose moves with the parameters by which it is read.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import CameraConfig
from dvrk_cmaes.geometry import Float64, Indices, Posed, apply
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.sections import plane_basis

PARAMETERS: Final = ("focal_length", "aspect", "centre_right", "centre_down", "radial", "instrument_size")

_STEP: Final = 1e-5  # m and rad
_ALONG: Final = 5e-3  # m, between the points of the shaft
_MOST: Final = 40  # vertices of a link
_JOINT: Final = np.deg2rad(10.0)  # standard deviation of joints that readings hold, where points are good to a pixel
_NEAR: Final = 5e-3  # m, of points in front of the camera
_LONGEST: Final = 0.15  # m of shaft, more than is in view
_HELD: Final = 1e-3  # px^2 per m^2 or rad^2: keeps the equations solvable


def file_covariance(camera: Camera | None, config: CameraConfig) -> Float64:
    """Return the covariance (6, 6) of the parameters, of the camera's that which its file states if it does."""
    centre = config.principal_point_percent / 100
    std = [config.focal_length_percent / 100, config.aspect_percent / 100, centre, centre, config.radial]
    covariance = np.diag(np.square([*std, config.instrument_size_percent / 100]))
    if camera is not None and camera.covariance:
        covariance[:-1, :-1] = camera.covariance
    return covariance


def displacements(camera: Camera, pixels: Float64, tangent: Float64) -> Float64:
    """Return the moves (N, 2, 5), px, of pixels (N, 2) of points with x/z, y/z (N, 2) by the camera's parameters."""
    focal, off = np.array([camera.fx, camera.fy]), pixels - [camera.cx, camera.cy]
    radial = focal * camera.by_radial(tangent)
    right, down = np.array([[camera.fx, 0.0], [0.0, camera.fx]])
    columns = [off, off * [-0.5, 0.5], *(np.broadcast_to(each, off.shape) for each in (right, down)), radial]
    return np.stack(columns, axis=2)


def moves_by_camera(instrument: Instrument, camera: Camera, at: Posed) -> Float64:
    """Return the change (6 + J, 6) of a pose and its joints with each parameter by which it is read.

    It is that of least squares over points of the instrument in the image, of which those of the shaft tell only where
    they are across it; zero where none is in view. A larger instrument is farther away in the same proportion.
    """
    count = 6 + len(at.joints)
    links, points = _points(instrument)
    changes = at.moved(_STEP * np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count)]))
    frames = (changes.pose[:, None] @ instrument.forward(changes.joints))[:, links]
    placed = (frames[..., :3, :3] @ points[..., None])[..., 0] + frames[..., :3, 3]
    seen = (placed[..., 2] > _NEAR).all(axis=0)
    placed, on_shaft = placed[:, seen], (links[seen] == 0) & (instrument.shaft is not None)
    pixels = camera.project(placed)
    inside = ((pixels[0] > -0.5) & (pixels[0] < [camera.width - 0.5, camera.height - 0.5])).all(axis=1)
    pixels, on_shaft = pixels[:, inside], on_shaft[inside]
    if not inside.any():
        return np.zeros((count, len(PARAMETERS)))
    by_pose = np.moveaxis(pixels[1 : count + 1] - pixels[count + 1 :], 0, 2) / (2 * _STEP)
    by_camera = displacements(camera, pixels[0], placed[0, inside, :2] / placed[0, inside, 2:])
    if on_shaft.any():
        along = np.linalg.svd(pixels[0, on_shaft] - pixels[0, on_shaft].mean(axis=0))[2][0]
        across = np.where(on_shaft[:, None, None], np.eye(2) - np.outer(along, along), np.eye(2))
        by_pose, by_camera = across @ by_pose, across @ by_camera
    by_pose, by_camera = by_pose.reshape(-1, count), by_camera.reshape(len(by_pose) * 2, -1)
    held = np.diag([_HELD] * 6 + [1 / _JOINT**2] * (count - 6))
    by_size = np.zeros((count, 1))
    by_size[:3, 0] = at.pose[:3, :3].T @ apply(at.pose, instrument.ends(at.joints)).mean(axis=0)
    return np.hstack([-np.linalg.solve(by_pose.T @ by_pose + held, by_pose.T @ by_camera), by_size])


def covariance_by_camera(instrument: Instrument, camera: Camera, at: Posed, errors: Float64) -> Float64:
    """Return the covariance (6 + J, 6 + J) of a pose by errors of the parameters, whose covariance is (6, 6)."""
    moves = moves_by_camera(instrument, camera, at)
    return np.asarray(moves @ errors @ moves.T)


@lru_cache(maxsize=8)
def _points(instrument: Instrument) -> tuple[Indices, Float64]:
    """Return points of the instrument: the links (N,) that have them, and their places (N, 3) there, m."""
    found, shaft = [], instrument.shaft
    for number, link in enumerate(instrument.links):
        points = link.vertices[:: max(len(link.vertices) // _MOST, 1)]
        if number == 0 and shaft is not None:
            along = np.arange(shaft.distal_end, max(shaft.proximal_end, shaft.distal_end - _LONGEST), -_ALONG)
            sides = shaft.radius * plane_basis(shaft.direction)
            axis = shaft.point + along[:, None] * shaft.direction
            points = np.concatenate([axis + side for side in (*sides, *-sides)])
        found.append((np.full(len(points), number), points))
    links, points = zip(*found, strict=True)
    return np.concatenate(links), np.concatenate(points)
