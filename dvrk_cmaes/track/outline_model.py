"""Drawing the outlines of an instrument in the views of a rig, and how their points move with pose and joints."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.shared_errors import NEAREST
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.moving_points import MovingPoints, moving_points
from dvrk_cmaes.track.drawn_outline import DrawnOutline

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

    def draw(self, at: Posed, views: tuple[int, ...]) -> DrawnOutline | None:
        """Find the outlines of a pose in some views; None where too little of the instrument is in any of them."""
        drawn = [outline for view in views if (outline := self._drawn_in(view, at)) is not None]
        return DrawnOutline.joined(views, drawn) if drawn else None

    def _drawn_in(self, view: int, at: Posed) -> DrawnOutline | None:
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
            views=(view,),
            at=at,
            parts={view: slice(None)},
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
        of_views = []
        for view, drawn in outline.by_view.items():
            seen = self._seen(view, at)
            here = Posed(seen.pose[None], seen.joints[None])
            of_views += moving_points(self.instrument, self.rig.views[view].camera, [drawn], here)
        moving = MovingPoints.joined(of_views)
        return None if moving.depth.min() < NEAREST else moving

    def _seen(self, view: int, at: Posed) -> Posed:
        """Return a pose of the reference camera in a view's."""
        return at.seen_from(self.rig.views[view].view_from_camera) if view else at


def _reduced(camera: Camera) -> Camera:
    """Return the camera of the images in which outlines are drawn."""
    shrink = max(camera.width // _DRAWN_WIDTH, 1)
    return camera.scaled(max(camera.width // shrink, 1), max(camera.height // shrink, 1))
