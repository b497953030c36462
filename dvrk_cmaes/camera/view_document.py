"""A camera of a rig as a document, as in ``session.json``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.camera.model import Camera
from dvrk_cmaes.camera.rig import View
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Count, Number, PositiveNumber, Transform


@dataclass(frozen=True, eq=False)
class ViewDocument(Document):
    """A camera for raw images, and its place in the rig.

    view : its name. width, height : px. fx, fy, cx, cy : px. model, distortion : as of `Camera`. view_from_camera :
    (4, 4), m, from the first view's camera to this one.
    """

    view: str
    width: Count
    height: Count
    fx: PositiveNumber
    fy: PositiveNumber
    cx: Number
    cy: Number
    model: str
    distortion: tuple[Number, ...]
    view_from_camera: Transform

    @classmethod
    def of(cls, view: View) -> ViewDocument:
        """Return the document of a view."""
        c = view.camera
        lens = c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.model, c.distortion
        return cls(view.name, *lens, np.asarray(view.view_from_camera))

    def restored(self) -> View:
        """Return the view; InputError as of `Camera`."""
        camera = Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy, tuple(self.distortion), self.model)
        return View(self.view, camera, self.view_from_camera)
