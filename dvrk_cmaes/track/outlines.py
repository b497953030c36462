"""Outlines of an instrument in the views of a rig: points that are fixed on it, and how they move with the pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.geometry import Float32, Float64, Indices, Posed
from dvrk_cmaes.pose.terms.shared_errors import NEAREST
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.moving_points import MovingPoints, moving_points

MOST_CLEARANCE: Final = 10
"""Longest piece of a line on either side of the outline that is looked at, in pixels of the image as it is sampled."""

_LARGEST_SCALE = 4  # of an image that is sampled at a reduced size

_BESIDE = 2.0  # px, farthest distance from a line of a point at which the outline crosses it
_OPPOSED = -0.2  # cosine between normals, below which a point lies on another side of the instrument
_NEXT = 1.0  # px along the line, within which a point is the same crossing


def clearance_of(pixels: Float64, normals: Float64) -> Float32:
    """Find where the lines through outline points (N, 2) along their normals (N, 2) cross the outline again.

    Returns the lengths (2, N), px, of the lines within the silhouette and beside it, as far as they are looked at.
    """
    at, outwards = pixels.astype(np.float32), normals.astype(np.float32)
    tangents = outwards[:, ::-1] * np.array([1, -1], np.float32)
    along = outwards @ at.T - np.einsum("nd,nd->n", outwards, at)[:, None]
    across = tangents @ at.T - np.einsum("nd,nd->n", tangents, at)[:, None]
    row, column = np.nonzero((np.abs(across) < _BESIDE) & (outwards @ outwards.T < _OPPOSED))
    distance = along[row, column]
    lengths = np.full((2, len(at)), _LARGEST_SCALE * MOST_CLEARANCE, np.float32)
    for side, away in zip(lengths, (-distance, distance), strict=True):
        beyond = away > _NEXT
        np.minimum.at(side, row[beyond], away[beyond])
    return lengths


@dataclass(frozen=True, eq=False)
class DrawnOutline:
    """N points on the outline of an instrument in one view of a rig, whose index is ``view``, fixed on the instrument.

    link : (N,) index of the link. points : (N, 3) m, in the link's frame. normals : (N, 2) unit vectors in the image,
    out of the silhouette. lengths : (N,) px of outline that each represents. pixels : (N, 2) where they were drawn.
    """

    view: int
    link: Indices
    points: Float64
    normals: Float64
    lengths: Float64
    pixels: Float64

    @cached_property
    def clearance(self) -> Float32:
        """Lengths (2, N), px, of lines along the normals of the outline, in the silhouette and beside it."""
        return clearance_of(self.pixels, self.normals)


_DRAWN_WIDTH = 640  # px; larger outlines are drawn about this wide, since their points are as exact
_BORDER = 2.0  # px from the image's border; points closer to it are not used
_LEAST_POINTS = 8  # of an outline in a view


class OutlineModel:
    """Draws the outlines of an instrument in the views of a rig and computes the motion of their points.

    Poses are in the reference camera, pixels in the view of each point. At most ``points`` of them are used in a view.
    """

    def __init__(self, body: Body, rig: Rig, points: int) -> None:
        self.rig = rig
        self.instrument = body.instrument
        self._renderers = [Renderer(body, _reduced(view.camera), threads=1) for view in rig.views]
        self._points = points

    def draw(self, at: Posed, view: int) -> DrawnOutline | None:
        """Find the outline of a pose in one view; None where too little of it is in the image."""
        camera, renderer, seen = self.rig.views[view].camera, self._renderers[view], self._seen(view, at)
        (outline,) = renderer.outlines(seen.pose[None], seen.joints[None])
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
            view=view,
            link=outline.link[chosen].astype(np.intp),
            points=outline.points[chosen],
            normals=outline.normals[chosen] / length[:, None],
            lengths=length * every * float(scale.mean()),
            pixels=pixels[chosen],
        )

    def move(self, outline: DrawnOutline, at: Posed) -> MovingPoints | None:
        """Project the points at a pose, and compute their motion; None if one of them is not in front of its camera.

        The pose's small changes are in the root's axes, which all views have in common.
        """
        seen, camera = self._seen(outline.view, at), self.rig.views[outline.view].camera
        (moving,) = moving_points(self.instrument, camera, [outline], Posed(seen.pose[None], seen.joints[None]))
        return None if moving.depth.min() < NEAREST else moving

    def _seen(self, view: int, at: Posed) -> Posed:
        """Return a pose of the reference camera in a view's."""
        return at.seen_from(self.rig.views[view].view_from_camera) if view else at


def _reduced(camera: Camera) -> Camera:
    """Return the camera of the images in which outlines are drawn."""
    shrink = max(camera.width // _DRAWN_WIDTH, 1)
    return camera.scaled(max(camera.width // shrink, 1), max(camera.height // shrink, 1))
