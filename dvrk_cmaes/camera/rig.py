"""A rig: the calibrated cameras that take one frame, such as the two eyes of a stereo endoscope.

The first view is the reference: poses in a frame are in its camera. ``view_from_camera`` maps points of the reference
camera's frame to that of a view. Image rows of the eyes need not be parallel, and their cameras may differ in all else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes.camera.model import Camera
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64, inverse, moved, rotation_angle, transform
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.io.encode import Document
from dvrk_cmaes.io.typed_document import Count, Number, PositiveNumber, Transform

BASELINE = (0.0005, 0.5)
"""Smallest and largest distance of the eyes of an endoscope or a stereo camera, m."""
_LARGEST_TURN = np.deg2rad(45.0)
_RIGID = 1e-6


@dataclass(frozen=True, eq=False)
class View:
    """One camera of a rig: its name, intrinsics and lens, and ``view_from_camera`` (4, 4), m."""

    name: str
    camera: Camera
    view_from_camera: Float64

    @property
    def camera_from_view(self) -> Float64:
        """The inverse of ``view_from_camera``, (4, 4)."""
        return inverse(self.view_from_camera)

    def turned(self, rotation: Float64) -> Self:
        """Return the view turned by a rotation vector (3,), rad, about the reference camera's axes."""
        return replace(self, view_from_camera=turned_place(self.view_from_camera, rotation))


V = TypeVar("V", bound=View)


@dataclass(frozen=True, eq=False)
class Rig:
    """One or more views, of which the first is the reference.

    Raises
    ------
    InputError
        No view, two of one name, a transform that is not rigid, a first one that is not the identity, views that are
        nearer than 0.5 mm or farther apart than 100 mm, or views turned by more than 45 degrees against the reference.
    """

    views: tuple[View, ...]

    def __post_init__(self) -> None:
        if not self.views:
            raise InputError("rig: expected at least one view, got none")
        if len(set(self.names)) != len(self.views):
            raise InputError(f"rig: expected views of different names, got {', '.join(self.names)}")
        for view in self.views:
            _check_transform(view)
        if not np.array_equal(self.views[0].view_from_camera, np.eye(4)):
            raise InputError(f"rig: view {self.names[0]}: expected the identity, as the first view is the reference")
        for view in self.views[1:]:
            _check_place(view)

    @staticmethod
    def of_camera(camera: Camera, name: str = "left") -> Rig:
        """Return the rig of a single camera.

        Parameters
        ----------
        camera
            The camera.
        name
            Name of its view.
        """
        return Rig((View(name, camera, np.eye(4)),))

    @staticmethod
    def of(camera: Camera | Rig) -> Rig:
        """Return a rig as it is, and a single camera as a rig; InputError for anything else.

        Parameters
        ----------
        camera
            A camera or a rig.
        """
        check_type("camera", camera, (Camera, Rig), "a Camera or a Rig (dvrk_cmaes.read_camera reads a file)")
        return Rig.of_camera(camera) if isinstance(camera, Camera) else camera

    @staticmethod
    def stereo(left: Camera, right: Camera, right_from_left: ArrayLike) -> Rig:
        """Return the rig of the views ``left`` and ``right``; ``right_from_left`` (4, 4) maps points, m.

        Parameters
        ----------
        left
            The camera of the left eye, the reference.
        right
            The camera of the right eye.
        right_from_left
            (4, 4), maps points of the left camera to the right one, m.
        """
        second = View("right", right, np.asarray(right_from_left, dtype=np.float64))
        return Rig((View("left", left, np.eye(4)), second))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the views."""
        return tuple(view.name for view in self.views)

    @property
    def camera(self) -> Camera:
        """The reference camera."""
        return self.views[0].camera

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is unusual about the cameras' files, of further views with the view's name."""
        return remarks_on_cameras(self.views)

    def view(self, name: str) -> View:
        """Return the view of a name; InputError, which lists the names, if there is none.

        Parameters
        ----------
        name
            Name of the view.
        """
        for view in self.views:
            if view.name == name:
                return view
        raise InputError(f"view: expected one of {', '.join(nearest_first(name, self.names))}, got {name!r}")

    def with_cameras(self, cameras: Mapping[str, Camera]) -> Rig:
        """Return the rig with other cameras for some views, by name, e.g. of images of another size.

        Parameters
        ----------
        cameras
            Cameras by name of the view.
        """
        for name in cameras:
            self.view(name)
        return Rig(tuple(replace(view, camera=cameras.get(view.name, view.camera)) for view in self.views))


def remarks_on_cameras(views: Sequence[View]) -> tuple[str, ...]:
    """Return the remarks on the cameras of views, the first one the reference, of further ones with the view's name."""
    first, *others = views
    further = [f"view {view.name}: {text}" for view in others for text in view.camera.remarks]
    return (*first.camera.remarks, *further)


def turned_place(view_from_camera: Float64, rotation: Float64) -> Float64:
    """Return the place (4, 4) of a view that is turned by a rotation vector (3,), rad, about the reference's axes."""
    return moved(view_from_camera, np.concatenate([np.zeros(3), rotation]))


def turned_views(views: Sequence[V], rotations: Mapping[str, Float64]) -> tuple[V, ...]:
    """Return views of which some are turned, by name, as `View.turned`."""
    return tuple(view.turned(rotations[view.name]) if view.name in rotations else view for view in views)


def mirrored_place(view_from_camera: Float64) -> Float64:
    """Return the place (4, 4) of a view on the other side of the reference, as if the two eyes were exchanged."""
    return transform(view_from_camera[:3, :3], -view_from_camera[:3, 3])


def _check_transform(view: View) -> None:
    """Raise an InputError for a transform that is not a rigid (4, 4)."""
    pose = np.asarray(view.view_from_camera)
    where = f"rig: view {view.name}: view_from_camera"
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InputError(f"{where}: expected a (4, 4) transform of finite numbers, got an array of shape {pose.shape}")
    off = np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max()
    if off > _RIGID or np.linalg.det(pose[:3, :3]) < 0 or not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise InputError(f"{where}: expected a rotation and a translation, got {pose.tolist()}")


def _check_place(view: View) -> None:
    """Raise an InputError for a view that cannot be another eye of the reference."""
    distance = float(np.linalg.norm(view.view_from_camera[:3, 3]))
    least, most = BASELINE
    if not least <= distance <= most:
        unit = " (millimetres where metres are expected?)" if least <= distance / 1e3 <= most else ""
        raise InputError(
            f"rig: view {view.name}: expected {1e3 * least:g} to {1e3 * most:g} mm between the eyes, "
            f"got {1e3 * distance:g} mm{unit}"
        )
    angle = float(rotation_angle(view.view_from_camera, np.eye(4)))
    if angle > _LARGEST_TURN:
        raise InputError(
            f"rig: view {view.name}: expected a rotation of at most 45 deg between the eyes, "
            f"got {np.degrees(angle):.1f} deg"
        )


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
