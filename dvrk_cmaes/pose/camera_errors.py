"""What errors of the camera file do to a pose: five parameters, what the file says of them, and how a pose follows.

The parameters are relative, so that they are the same for an image of any size and crop: the logarithm of the focal
length, that of fy / fx, the principal point right and down over the focal length, and the first radial coefficient.
An outline that is seen stays where it is in the image, so that a pose moves with the parameters by which it is read.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import CameraConfig
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.sections import plane_basis

PARAMETERS: Final = ("focal_length", "aspect", "centre_right", "centre_down", "radial")

_STEP: Final = 1e-5  # m and rad
_ALONG: Final = 5e-3  # m, between the points of the shaft
_MOST: Final = 40  # vertices of a link
_JOINT: Final = np.deg2rad(10.0)  # standard deviation of joints that readings hold, where points are good to a pixel
_NEAR: Final = 5e-3  # m, of points in front of the camera
_LONGEST: Final = 0.15  # m of shaft, more than is in view
_HELD: Final = 1e-3  # px^2 per m^2 or rad^2: keeps the equations solvable


def file_covariance(camera: Camera, config: CameraConfig) -> Float64:
    """Return the covariance (5, 5) of the parameters in a camera file: that which it states, else the settings'."""
    return np.array(camera.covariance) if camera.covariance else usual_covariance(config)


def usual_covariance(config: CameraConfig) -> Float64:
    """Return the covariance (5, 5) of the parameters that the settings state."""
    centre = config.principal_point_percent / 100
    std = [config.focal_length_percent / 100, config.aspect_percent / 100, centre, centre, config.radial]
    return np.diag(np.square(std))


def displacements(camera: Camera, pixels: Float64, tangent: Float64) -> Float64:
    """Return by how much the pixels (N, 2) of points with x/z, y/z (N, 2) move with each parameter, (N, 2, 5) px."""
    focal, off = np.array([camera.fx, camera.fy]), pixels - [camera.cx, camera.cy]
    radial = focal * camera.by_radial(tangent)
    right, down = np.array([[camera.fx, 0.0], [0.0, camera.fx]])
    columns = [off, off * [-0.5, 0.5], *(np.broadcast_to(each, off.shape) for each in (right, down)), radial]
    return np.stack(columns, axis=2)


def moves_by_camera(instrument: Instrument, camera: Camera, at: Posed) -> Float64:
    """Return the change (6 + J, 5) of a pose and its joints with each parameter of the camera by which it is read.

    It is that of least squares over points of the instrument in the image, of which those of the shaft tell only where
    they are across it; zero where none is in view.
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
    by_pose, by_camera = by_pose.reshape(-1, count), by_camera.reshape(-1, len(PARAMETERS))
    held = np.diag([_HELD] * 6 + [1 / _JOINT**2] * (count - 6))
    return -np.asarray(np.linalg.solve(by_pose.T @ by_pose + held, by_pose.T @ by_camera))


def covariance_by_camera(instrument: Instrument, camera: Camera, at: Posed, errors: Float64) -> Float64:
    """Return the covariance (6 + J, 6 + J) of a pose by errors of the camera, whose covariance is (5, 5)."""
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
