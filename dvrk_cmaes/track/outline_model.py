"""Drawing the outlines of an instrument in the views of a rig, and how their points move with pose and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.geometry import Posed, apply
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.track.drawn_outline import DrawnOutline

Float64 = NDArray[np.float64]

_DRAWN_WIDTH = 640  # px; larger outlines are drawn about this wide, since their points are as exact
_BORDER = 2.0  # px from the image's border; points closer to it are not used
_LEAST_POINTS = 8  # of an outline in a view
_STEP = 1e-5  # of normalised coordinates, for the derivatives of a lens
_NEAREST = 1e-3  # m, least depth of a point


@dataclass(frozen=True, eq=False)
class Projected:
    """Outline points at a pose: ``pixels`` (N, 2), and ``jacobian`` (N, 6 + J) of their motion along the normals."""

    pixels: Float64
    jacobian: Float64


class OutlineModel:
    """Draws the outlines of an instrument in the views of a rig and computes the motion of their points.

    Poses are in the reference camera, pixels in the view of each point. At most ``points`` of them are used in a view.
    """

    def __init__(self, body: Body, rig: Rig, points: int) -> None:
        self.rig = rig
        self.instrument = body.instrument
        self._renderers = [Renderer(body, _reduced(view.camera), threads=1) for view in rig.views]
        self._points = points

    def draw(self, at: Posed, views: tuple[int, ...]) -> DrawnOutline | None:
        """Find the outlines of a pose in some views; None where too little of the instrument is in any of them."""
        drawn = [outline for view in views if (outline := self._drawn_in(view, at)) is not None]
        return DrawnOutline.joined(views, drawn) if drawn else None

    def _drawn_in(self, view: int, at: Posed) -> DrawnOutline | None:
        """Find the outline of a pose in one view; None where too little of it is in the image."""
        camera, renderer, seen = self.rig.views[view].camera, self._renderers[view], self._seen(view, at)
        outline = renderer.outlines(seen.pose[None], seen.joints[None])
        scale = np.array([camera.width / renderer.camera.width, camera.height / renderer.camera.height])
        lengths = np.linalg.norm(outline.normals, axis=1)
        pixels = (outline.pixels + 0.5) * scale - 0.5
        high = np.array([camera.width, camera.height]) - 1 - _BORDER
        inside = ((pixels > _BORDER) & (pixels < high)).all(axis=1) & (lengths > 0)
        index = np.flatnonzero(inside)
        if len(index) < _LEAST_POINTS:
            return None
        count = min(len(index), self._points)
        every = len(index) / count
        chosen = index[np.linspace(0, len(index) - 1, count).astype(np.intp)]
        length = lengths[chosen]
        return DrawnOutline(
            views=(view,),
            at=at,
            parts={view: slice(None)},
            all_pixels={view: pixels[inside]},
            link=outline.link[chosen].astype(np.intp),
            points=outline.points[chosen],
            normals=outline.normals[chosen] / length[:, None],
            lengths=length * every * float(scale.mean()),
            pixels=pixels[chosen],
        )

    def draw_anew(
        self, last: DrawnOutline | None, at: Posed, tolerance: float, views: tuple[int, ...]
    ) -> DrawnOutline | None:
        """Return the last outlines if root and joints have turned by at most ``tolerance`` rad since; else draw them.

        Those of other views than ``views`` are drawn, too.
        """
        if last is not None and last.views == views and last.turned(at) <= tolerance:
            return last
        return self.draw(at, views)

    def place(self, outline: DrawnOutline, at: Posed) -> Float64 | None:
        """Project the points at a pose, (N, 2); None if one is not in front of its camera."""
        links, pixels = self.instrument.forward(at.joints), np.empty_like(outline.pixels)
        for view, part in outline.parts.items():
            points = apply(self._seen(view, at).pose, _in_root(outline.by_view[view], links))
            if points[:, 2].min() < _NEAREST:
                return None
            pixels[part] = self.rig.views[view].camera.project(points)
        return pixels

    def project(self, outline: DrawnOutline, at: Posed) -> Projected | None:
        """Project the points at a pose, with their Jacobian; None if one of them is not in front of its camera.

        The Jacobian's columns are the small changes of `Posed`, which all views have in common.
        """
        links, twists = self.instrument.twists(at.joints)
        pixels, jacobian = np.empty_like(outline.pixels), np.empty((len(outline.pixels), 6 + len(at.joints)))
        for view, part in outline.parts.items():
            drawn, camera, pose = outline.by_view[view], self.rig.views[view].camera, self._seen(view, at).pose
            in_root = _in_root(drawn, links)
            seen = apply(pose, in_root)
            depth = seen[:, 2:]
            if depth.min() < _NEAREST:
                return None
            xy = seen[:, :2] / depth
            pixels[part], across = _in_image(camera, xy, drawn.normals)
            # how far a point moves along its normal when it moves in the camera, (N, 3), then in the root's axes
            slope = np.concatenate([across, -(across * xy).sum(axis=1, keepdims=True)], axis=1) / depth
            (x, y, z), (a, b, c) = in_root.T, (slope @ pose[:3, :3]).T
            by_pose = np.stack([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
            jacobian[part, :6] = by_pose
            jacobian[part, 6:] = np.einsum("nk,nkj->nj", by_pose, twists[drawn.link])
        return Projected(pixels, jacobian)

    def _seen(self, view: int, at: Posed) -> Posed:
        """Return a pose of the reference camera in a view's."""
        return at.seen_from(self.rig.views[view].view_from_camera) if view else at


def _reduced(camera: Camera) -> Camera:
    """Return the camera of the images in which outlines are drawn."""
    shrink = max(camera.width // _DRAWN_WIDTH, 1)
    return camera.scaled(max(camera.width // shrink, 1), max(camera.height // shrink, 1))


def _in_image(camera: Camera, xy: Float64, normals: Float64) -> tuple[Float64, Float64]:
    """Return the pixels (N, 2) of points at normalised coordinates (N, 2), and their motion along the normals.

    The motion (N, 2) is the derivative by the coordinates.
    """
    focal, principal = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    if camera.is_pinhole:
        return xy * focal + principal, normals * focal
    steps = _STEP * np.array([[0.0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    distorted = camera.distort(xy + steps[:, None])
    motion = (distorted[1::2] - distorted[2::2]) / (2 * _STEP)  # (2, N, 2)
    return distorted[0] * focal + principal, ((motion * (normals * focal)).sum(axis=2)).T


def _in_root(outline: DrawnOutline, links: Float64) -> Float64:
    """Compute an outline's points in the root's frame, (N, 3), from the poses of the links, (L, 4, 4)."""
    matrix = links[:, :3].swapaxes(1, 2).reshape(-1, 3)
    return np.asarray(outline.by_link @ matrix[: outline.by_link.shape[1]])
