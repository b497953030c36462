"""The outline of a pose, and how its points move in the image with the pose and the joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import apply, rotation_angle
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.track.outline_room import Room

Float64 = NDArray[np.float64]

_DRAWN_WIDTH = 640  # px; larger outlines are drawn about this wide, since their points are as exact
_BORDER = 2.0  # px from the image's border; points closer to it are not used
_STEP = 1e-5  # of normalised coordinates, for the derivatives of a lens
_NEAREST = 1e-3  # m, least depth of a point


@dataclass(frozen=True, eq=False)
class Rim:
    """N points of an outline, fixed on the instrument.

    link : (N,) index of the link. points : (N, 3) m, in the link's frame. normals : (N, 2) unit vectors in the image,
    out of the silhouette. lengths : (N,) px of outline that each represents. ``all_pixels`` (M, 2) are all points of
    the outline, before N of them were chosen; ``pixels`` (N, 2) are those of the N points. ``pose`` (4, 4) and
    ``joints`` (J,) are those it was drawn at.
    """

    link: NDArray[np.intp]
    points: Float64
    normals: Float64
    lengths: Float64
    all_pixels: Float64
    pixels: Float64
    pose: Float64
    joints: Float64

    @cached_property
    def by_link(self) -> Float64:
        """Homogeneous points (N, 4 L), in the columns of their links; the other columns are zero."""
        found = np.zeros((len(self.link), int(self.link.max(initial=0)) + 1, 4))
        row = np.arange(len(self.link))
        found[row, self.link, :3], found[row, self.link, 3] = self.points, 1.0
        return found.reshape(len(found), -1)

    @cached_property
    def room(self) -> Room:
        """How far the lines along the normals run within the silhouette and beside it."""
        return Room.of(self.pixels, self.normals)

    def turned(self, pose: Float64, joints: Float64) -> float:
        """Return the largest angle, rad, between the root or a joint and those it was drawn at."""
        return max(float(rotation_angle(self.pose, pose)), float(np.abs(self.joints - joints).max()))


@dataclass(frozen=True, eq=False)
class Projected:
    """Rim points at a pose: ``pixels`` (N, 2), and ``jacobian`` (N, 6 + J) of their displacement along the normals."""

    pixels: Float64
    jacobian: Float64


class OutlineModel:
    """Draws the outlines of an instrument in a camera and computes the motion of their points."""

    def __init__(self, body: Body, camera: Camera, points: int) -> None:
        shrink = max(camera.width // _DRAWN_WIDTH, 1)
        small = camera.scaled(max(camera.width // shrink, 1), max(camera.height // shrink, 1))
        self._renderer = Renderer(body, small, threads=1)
        self._scale = np.array([camera.width / small.width, camera.height / small.height])
        self._focal, self._principal = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
        self.camera = camera
        self.instrument = body.instrument
        self._points = points

    def draw(self, pose: Float64, joints: Float64) -> Rim | None:
        """Find the outline of a pose (4, 4) and joints (J,); None where too little of it is in the image."""
        outline = self._renderer.outlines(pose[None], joints[None])
        lengths = np.linalg.norm(outline.normals, axis=1)
        pixels = (outline.pixels + 0.5) * self._scale - 0.5
        high = np.array([self.camera.width, self.camera.height]) - 1 - _BORDER
        inside = ((pixels > _BORDER) & (pixels < high)).all(axis=1) & (lengths > 0)
        index = np.flatnonzero(inside)
        if len(index) < 8:
            return None
        count = min(len(index), self._points)
        every = len(index) / count
        chosen = index[np.linspace(0, len(index) - 1, count).astype(np.intp)]
        length = lengths[chosen]
        return Rim(
            outline.link[chosen].astype(np.intp),
            outline.points[chosen],
            outline.normals[chosen] / length[:, None],
            length * every * float(self._scale.mean()),
            pixels[inside],
            pixels[chosen],
            pose,
            joints,
        )

    def draw_anew(self, last: Rim | None, pose: Float64, joints: Float64, tolerance: float) -> Rim | None:
        """Return the last outline if root and joints have turned by at most ``tolerance`` rad since; else draw it."""
        if last is not None and last.turned(pose, joints) <= tolerance:
            return last
        return self.draw(pose, joints)

    def place(self, rim: Rim, pose: Float64, joints: Float64) -> Float64 | None:
        """Project a rim's points at a pose (4, 4) and joints (J,), (N, 2); None if one is behind the camera."""
        seen = apply(pose, _in_root(rim, self.instrument.forward(joints)))
        return None if seen[:, 2].min() < _NEAREST else np.asarray(self.camera.project(seen))

    def project(self, rim: Rim, pose: Float64, joints: Float64) -> Projected | None:
        """Project a rim's points at a pose (4, 4) and joints (J,); None if one of them is not in front of the camera.

        The Jacobian's columns are the small changes of the pose in the root's axes, then the joints.
        """
        links, twists = self.instrument.twists(joints)
        at = _in_root(rim, links)
        seen = apply(pose, at)
        depth = seen[:, 2:]
        if depth.min() < _NEAREST:
            return None
        xy = seen[:, :2] / depth
        pixels, across = self._in_image(xy, rim.normals)
        # how far a point moves along its normal when it moves in the camera, (N, 3), then in the root's axes
        slope = np.concatenate([across, -(across * xy).sum(axis=1, keepdims=True)], axis=1) / depth
        (x, y, z), (a, b, c) = at.T, (slope @ pose[:3, :3]).T
        by_pose = np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
        by_joints = np.einsum("nk,nkj->nj", by_pose, twists[rim.link])
        return Projected(pixels, np.concatenate([by_pose, by_joints], axis=1))

    def _in_image(self, xy: Float64, normals: Float64) -> tuple[Float64, Float64]:
        """Return the pixels (N, 2) of points at normalised coordinates (N, 2), and their motion along the normals.

        The motion (N, 2) is the derivative by the coordinates.
        """
        if self.camera.is_pinhole:
            return xy * self._focal + self._principal, normals * self._focal
        steps = _STEP * np.array([[0.0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        distorted = self.camera.distort(xy + steps[:, None])
        motion = (distorted[1::2] - distorted[2::2]) / (2 * _STEP)  # (2, N, 2)
        return distorted[0] * self._focal + self._principal, ((motion * (normals * self._focal)).sum(axis=2)).T


def _in_root(rim: Rim, links: Float64) -> Float64:
    """Compute a rim's points in the root's frame, (N, 3), from the poses of the links, (L, 4, 4)."""
    matrix = links[:, :3].swapaxes(1, 2).reshape(-1, 3)
    return np.asarray(rim.by_link @ matrix[: rim.by_link.shape[1]])
