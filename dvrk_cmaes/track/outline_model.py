"""The outline of a pose, and how its points move in the image with the pose and the joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import apply, change_between
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.track.outline_room import Room

Float64 = NDArray[np.float64]

_DRAWN_WIDTH = 640  # px; larger outlines are drawn about this wide, since their points are as exact
_BORDER = 2.0  # px from the image's border; points closer to it are not used
_STEP = 1e-5  # m and rad, of central differences
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
    def room(self) -> Room:
        """How far the lines along the normals run within the silhouette and beside it."""
        return Room.of(self.pixels, self.normals)

    def turned(self, pose: Float64, joints: Float64) -> float:
        """Return the largest angle, rad, between the root or a joint and those it was drawn at."""
        return float(max(np.abs(change_between(self.pose, pose)[3:]).max(), np.abs(self.joints - joints).max()))


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
        seen = apply(pose, self._in_root(rim, joints[None])[0])
        return None if seen[:, 2].min() < _NEAREST else np.asarray(self.camera.project(seen))

    def _in_root(self, rim: Rim, joints: Float64) -> Float64:
        """Compute a rim's points in the root's frame for C joint values (C, J), (C, N, 3)."""
        links = self.instrument.forward(joints)
        edges = np.searchsorted(rim.link, np.arange(links.shape[1] + 1))
        found = np.empty((len(joints), len(rim.points), 3))
        for link, (begin, end) in enumerate(pairwise(edges)):
            rotation = links[:, link, :3, :3].swapaxes(-1, -2)
            found[:, begin:end] = rim.points[begin:end] @ rotation + links[:, link, None, :3, 3]
        return found

    def project(self, rim: Rim, pose: Float64, joints: Float64) -> Projected | None:
        """Project a rim's points at a pose (4, 4) and joints (J,); None if one of them is not in front of the camera.

        The Jacobian's columns are the small changes of the pose in the root's axes, then the joints.
        """
        count = len(joints)
        bent = np.concatenate([joints[None], joints + _STEP * np.eye(count), joints - _STEP * np.eye(count)])
        in_root = self._in_root(rim, bent)
        at = in_root[0]
        seen = apply(pose, at)
        if seen[:, 2].min() < _NEAREST:
            return None
        ends = np.stack([seen + _STEP * axis for axis in np.eye(3)] + [seen - _STEP * axis for axis in np.eye(3)])
        pixels = self.camera.project(np.concatenate([seen[None], ends]))
        # how far a point moves along its normal when it moves in the camera, (N, 3), then in the root's axes
        slope = np.einsum("anu,nu->na", (pixels[1:4] - pixels[4:]) / (2 * _STEP), rim.normals)
        in_axes = slope @ pose[:3, :3]
        bending = (in_root[1 : 1 + count] - in_root[1 + count :]) / (2 * _STEP)
        columns = [in_axes, np.cross(at, in_axes), np.einsum("jna,na->nj", bending, in_axes)]
        return Projected(pixels[0], np.concatenate(columns, axis=1))
