"""Rendering of silhouettes for many poses: sums of images over silhouettes, masks, antialiased coverage, outlines.

The kernel draws each pose by itself, so results do not depend on the number of threads, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, pairwise
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes import _kernel
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool, Float32, Float64, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.arguments import check_type, checked_array, described
from dvrk_cmaes.silhouette.outline import OutlinePoints
from dvrk_cmaes.silhouette.scenes import NEAR, LinkScenes, decimate

T = TypeVar("T")
S = TypeVar("S", bound=np.generic)
Joints = Float64 | Mapping[str, ArrayLike]
"""Joint values (C, J), rad, in the order of the instrument's joints, or by name, each a number or (C,)."""

METHODS = ("count", "rays")
"""Ways to decide what is covered between crossings of an image line with outline edges.

They are the number of layers of faces along the line, or one ray through the middle, traced together for many poses.
"""

_STEP = 0.3  # px, by which the outline moves for differences
_LEVERS = (
    1.0,
    1.0,
    1.0,
    0.01,
    0.01,
    0.004,
)  # m by unit: translations, tilts, turn about the axis
_JOINT_LEVER = 0.01  # m by rad of a joint
_DRAWN, _SUMMED = 16, 64
"""Largest number of poses that are drawn, and of those of which only sums are computed, in a slice of a long call."""


@lru_cache(maxsize=256)
def kernel_camera(camera: Camera) -> _kernel.Camera:
    """Return a camera as the kernel takes it; cached."""
    c, coefficients = camera, () if camera.is_pinhole else camera.distortion
    return _kernel.Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.model, coefficients, c.lens_radius)


@dataclass(frozen=True, eq=False)
class Body:
    """An instrument prepared for rendering: its meshes with their edges, and its Embree scenes. Renderers may share it.

    Each of these is computed when it is first needed.
    """

    instrument: Instrument
    error_m: float = 0.0
    """Upper bound of the distance of its surface from the instrument's, m."""
    method: str = "count"
    """How renderers decide what the instrument covers, one of ``METHODS``."""

    def __repr__(self) -> str:
        """Show the instrument."""
        return f"Body({self.instrument!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is prepared from."""
        return Body, (self.instrument, self.error_m, self.method)

    @staticmethod
    def prepare(instrument: Instrument) -> Body:
        """Prepare an instrument.

        Parameters
        ----------
        instrument
            The instrument, whose meshes are prepared.
        """
        return Body(instrument)

    @cached_property
    def mesh(self) -> _kernel.Mesh:
        """The meshes with their edges."""
        return _kernel.Mesh([(link.vertices, link.faces) for link in self.instrument.links])

    @cached_property
    def scenes(self) -> LinkScenes:
        """The Embree scenes."""
        return LinkScenes(self.instrument)

    def decimated(self, cell: float) -> Body:
        """Return a body with fewer faces for images of low resolution, decimated on a grid with cells of ``cell`` m.

        Parameters
        ----------
        cell
            Width of the grid's cells, m.
        """
        instrument, error = decimate(self.instrument, cell)
        return Body(instrument, self.error_m + error, self.method)

    def camera_from_links(self, camera_from_root: Float64, joints: Float64) -> Float64:
        """Compute the poses of all links, (C, L, 4, 4), from those of the root, (C, 4, 4), and joints (C, J).

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        """
        return np.asarray(camera_from_root[:, None] @ self.instrument.forward(joints))


@dataclass(frozen=True, eq=False)
class PixelSums:
    """Prefix sums along the rows of images that are to be summed over silhouettes.

    ``table`` (H, W + 1, K) holds the sums of K images from the left border to the left side of each pixel.
    """

    table: Float64

    @staticmethod
    def of(images: NDArray[np.floating], weight: NDArray[np.floating] | None = None) -> PixelSums:
        """Compute the prefix sums of images (K, H, W), each multiplied by a weight (H, W)."""
        weighted = np.asarray(images if weight is None else images * weight, dtype=np.float64)
        count, height, width = weighted.shape
        table = np.zeros((height, width + 1, count))
        np.cumsum(np.moveaxis(weighted, 0, -1), axis=1, out=table[:, 1:])
        return PixelSums(table)


class Renderer:
    """Renders silhouettes of one instrument in one camera; may be used from several threads at once.

    All methods take C poses at a time: ``camera_from_root`` (C, 4, 4), m, and ``joints`` (C, J), rad, in the order of
    ``body.instrument.joint_names`` (wrist_pitch, wrist_yaw, jaw of the bundled instrument). Images are (C, H, W).
    `masks`, `coverage` and `trace` take a single pose (4, 4), too, and joints by name; their image is then (H, W).

    Parameters
    ----------
    body
        The instrument, prepared for rendering (`dvrk_cmaes.prepare`).
    camera
        The camera, whose images are H by W pixels.
    threads
        Number of threads; the images do not depend on it.

    Raises
    ------
    InputError
        No `Body` or `Camera`; or, by the methods, arrays of other shapes, or numbers that are not finite.
    """

    def __init__(self, body: Body, camera: Camera, *, threads: int = 2) -> None:
        check_type("body", body, Body, "a Body (dvrk_cmaes.prepare makes one)")
        check_type("camera", camera, Camera, "a Camera")
        self.body = body
        self.camera = camera
        self.threads = threads
        self.rays = 0
        """Number of rays traced so far."""
        self.poses = 0
        """Number of poses rendered so far."""
        self._counting = Lock()

    def __repr__(self) -> str:
        """Show the instrument and the camera."""
        return f"Renderer({self.body!r}, {self.camera!r})"

    def __getstate__(self) -> tuple[Body, Camera, int]:
        """Pickle what it is made from."""
        return self.body, self.camera, self.threads

    def __setstate__(self, state: tuple[Body, Camera, int]) -> None:
        """Make it anew."""
        body, camera, threads = state
        Renderer.__init__(self, body, camera, threads=threads)

    def at(self, width: int, height: int) -> Renderer:
        """Return a renderer of the same body in the same camera, scaled to another image size in pixels.

        Parameters
        ----------
        width
            Width of the images, px.
        height
            Height of the images, px.
        """
        return Renderer(self.body, self.camera.scaled(width, height), threads=self.threads)

    def sums(
        self,
        camera_from_root: Float64,
        joints: Float64,
        images: PixelSums,
        *,
        lines_per_pixel: int = 1,
        to_pixel: bool = False,
        part: tuple[int, int] | None = None,
    ) -> Float64:
        """Sum K images over the silhouettes of C poses, (C, K), without rendering an image.

        With ``to_pixel``, the sums are over the pixels whose centres are covered. Otherwise they are integrals over the
        area within the outline, which are continuous in the pose.

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        images
            The K images whose pixels are summed.
        lines_per_pixel
            Lines of the image along which edges are found, for each row of pixels.
        to_pixel
            Whether to sum over whole pixels instead of integrating over areas.
        part
            Links, from one to before another one, by whose silhouettes images are summed, too: (2, C, K), those of all
            links first; of a body that is drawn without rays.
        """
        camera, mesh = kernel_camera(self.camera), self.body.mesh

        def add(links: Float64) -> Float64:
            return mesh.sums(camera, links, images.table, lines_per_pixel, to_pixel, self.threads, self._trace, part)

        found = np.concatenate(self._in_batches(camera_from_root, joints, add, _SUMMED), axis=1)
        return found if part is not None else found[0]

    def coverage(self, camera_from_root: Float64, joints: Joints, *, lines_per_pixel: int = 4) -> Float32:
        """Render antialiased silhouettes of C poses: the covered fraction of each pixel, (C, H, W).

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), or one, (4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`, or by name.
        lines_per_pixel
            Lines of the image along which edges are found, for each row of pixels.
        """
        camera, mesh = kernel_camera(self.camera), self.body.mesh

        def draw(links: Float64) -> Float32:
            return mesh.coverage(camera, links, lines_per_pixel, self.threads, self._trace)

        poses, values = self._arrays(camera_from_root, joints)
        return _like(camera_from_root, _joined(self._in_batches(poses, values, draw, _DRAWN)))

    def outlines(self, camera_from_root: Float64, joints: Float64, *, lines_per_pixel: int = 1) -> list[OutlinePoints]:
        """Find points on the outlines of C poses, in the image and on the instrument, on pixel rows and columns.

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`.
        lines_per_pixel
            Lines of the image on which points are found, for each row of pixels.
        """
        camera, mesh = kernel_camera(self.camera), self.body.mesh

        def draw(links: Float64) -> list[OutlinePoints]:
            drawn = mesh.outlines(camera, links, lines_per_pixel, self.threads, self._trace)
            begin, link, pixels, normals, points = drawn
            parts = [slice(*ends) for ends in pairwise(begin.tolist())]
            return [OutlinePoints(link[part], pixels[part], normals[part], points[part]) for part in parts]

        return list(chain.from_iterable(self._in_batches(camera_from_root, joints, draw, _DRAWN)))

    def compare(
        self,
        at: Posed,
        target: _kernel.Target,
        cauchy: Sequence[float],
        *,
        lines_per_pixel: int = 2,
        outlines: bool = True,
    ) -> list[_kernel.Comparison]:
        """Compare the coverage of C poses with a blurred mask, and find their outlines if these are asked for.

        Parameters
        ----------
        at
            The poses in the camera.
        target
            The mask, of the size of the camera's images.
        cauchy
            Widths of the robust losses of the differences.
        lines_per_pixel
            Lines of the image along which edges are found, for each row of pixels.
        outlines
            Whether to find the outlines, on all these lines and on the columns, and how they move with pose and joints.
        """
        _check_poses(self.body.instrument.joint_names, at.pose, at.joints)
        instrument, camera, by_joint = self.body.instrument, kernel_camera(self.camera), None
        if outlines:
            root_from_link, by_joint = instrument.forward_with_derivatives(at.joints)
        else:
            root_from_link = instrument.forward(at.joints)
        links, found = at.pose[:, None] @ root_from_link, []
        for begin in range(0, len(links), _DRAWN):
            part = slice(begin, begin + _DRAWN)
            found += self.body.mesh.compare(
                camera,
                target,
                np.ascontiguousarray(at.pose[part]),
                root_from_link[part],
                None if by_joint is None else by_joint[part],
                links[part],
                lines_per_pixel,
                cauchy,
                self.threads,
                self._trace,
            )
        self._count(poses=len(links))
        return found

    def difference(self, compared: Sequence[_kernel.Comparison], at: Posed, *, lines_per_pixel: int = 2) -> None:
        """Replace the derivatives of the outlines of C comparisons by central differences of outlines drawn anew.

        Each of the D = 6 + J unknowns is changed by a step that moves the outline by about ``_STEP`` px, either way.

        Parameters
        ----------
        compared
            What `compare` returned, with outlines.
        at
            The poses in the camera, as they were compared.
        lines_per_pixel
            Lines of the image on which outlines were found, for each row of pixels.
        """
        body, count, joints = self.body, len(at), at.joints.shape[1]
        pixel = np.abs(at.pose[:, 2, 3]) / np.sqrt(self.camera.fx * self.camera.fy)  # m at the root's distance
        steps = np.ascontiguousarray(_STEP * pixel[:, None] / np.array(_LEVERS + (_JOINT_LEVER,) * joints))
        changes = np.concatenate([np.eye(6 + joints), -np.eye(6 + joints)]) * steps[:, None]
        moved = at[np.repeat(np.arange(count), changes.shape[1])].moved(changes.reshape(-1, 6 + joints))
        links = np.ascontiguousarray(body.camera_from_links(moved.pose, moved.joints))
        camera = kernel_camera(self.camera)
        body.mesh.difference(camera, list(compared), links, steps, lines_per_pixel, self.threads, self._trace)
        self._count(poses=len(links))

    def contours(
        self, at: Posed, mask: Bool, weight: Float32, errors: _kernel.ContourErrors
    ) -> tuple[Float64, Float64, Float64]:
        """Compare the outlines of C poses with the contour of a mask (H, W), and weigh its correlated errors.

        Returns information (C, 6 + J, 6 + J) and slope (C, 6 + J) of half the sums of squares by small changes of the
        poses, and the sums (C,).

        Parameters
        ----------
        at
            The poses in the camera.
        mask
            The mask, of the size of the camera's images.
        weight
            (H, W), 0 for ignored pixels.
        errors
            How the errors are weighed.
        """
        _check_poses(self.body.instrument.joint_names, at.pose, at.joints)
        root_from_link, by_joint = self.body.instrument.forward_with_derivatives(at.joints)
        links, poses = at.pose[:, None] @ root_from_link, np.ascontiguousarray(at.pose)
        found = self.body.mesh.contours(
            kernel_camera(self.camera),
            mask,
            weight,
            poses,
            root_from_link,
            by_joint,
            links,
            errors,
            self.threads,
            self._trace,
        )
        self._count(poses=len(links))
        return found

    def masks(self, camera_from_root: Float64, joints: Joints) -> Bool:
        """Render masks of C poses: whether each pixel's centre is covered, (C, H, W).

        Parameters
        ----------
        camera_from_root
            (C, 4, 4), or one, (4, 4), m: poses of the root link in the camera.
        joints
            (C, J), rad, in the order of ``body.instrument.joint_names``, or by name, each a number or (C,).
        """
        camera, mesh = kernel_camera(self.camera), self.body.mesh

        def draw(links: Float64) -> Bool:
            return mesh.masks(camera, links, self.threads, self._trace)

        poses, values = self._arrays(camera_from_root, joints)
        return _like(camera_from_root, _joined(self._in_batches(poses, values, draw, _DRAWN)))

    def trace(self, camera_from_root: Float64, joints: Joints) -> Bool:
        """Trace one ray through the centre of every pixel: the reference for ``masks``, (C, H, W).

        Parameters
        ----------
        camera_from_root
            Poses of the root link in the camera, (C, 4, 4), or one, (4, 4), m.
        joints
            Joint values, (C, J), rad, in the order of the instrument's `joint_names`, or by name.
        """
        height, width = self.camera.height, self.camera.width
        v, u = np.mgrid[:height, :width]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float64)
        directions = np.c_[self.camera.normalise(pixels), np.ones(len(pixels))]
        links = self.body.camera_from_links(*self._arrays(camera_from_root, joints))
        pose = np.zeros(len(pixels), dtype=np.intp)
        found = np.empty((len(links), height, width), dtype=np.bool_)
        for one, image in zip(links, found, strict=True):
            image[:] = self.body.scenes.covered(one[None], pose, directions).reshape(height, width)
        self._count(rays=found.size)
        return _like(camera_from_root, found)

    def _arrays(self, camera_from_root: Float64, joints: Joints) -> tuple[Float64, Float64]:
        """Return poses as (C, 4, 4), C = 1 of a single one, and joints as an array in the instrument's order."""
        if isinstance(camera_from_root, np.ndarray) and camera_from_root.shape == (4, 4):
            camera_from_root = camera_from_root[None]
        if not isinstance(joints, Mapping):
            return camera_from_root, joints
        names = self.body.instrument.joint_names
        if {*joints} != {*names}:
            raise InputError(
                f"joints: expected values of {', '.join(names)}, got {', '.join(map(str, joints)) or 'none'}"
            )
        columns = [checked_array(f"joints: {name}", joints[name], np.float64, "a number, or (C,)") for name in names]
        count = len(camera_from_root) if isinstance(camera_from_root, np.ndarray) else 1
        if wrong := [name for name, column in zip(names, columns, strict=True) if column.shape not in ((), (count,))]:
            raise InputError(f"joints: {wrong[0]}: expected a number, or ({count},), got {described(joints[wrong[0]])}")
        return camera_from_root, np.stack([np.broadcast_to(column, count) for column in columns], axis=1)

    def _in_batches(
        self, camera_from_root: Float64, joints: Float64, draw: Callable[[Float64], T], most: int
    ) -> list[T]:
        """Check C poses, and draw those of their links, (C, L, 4, 4), in batches of at most ``most``."""
        _check_poses(self.body.instrument.joint_names, camera_from_root, joints)
        links = np.ascontiguousarray(self.body.camera_from_links(camera_from_root, joints))
        drawn = []
        for begin in range(0, max(len(links), 1), most):
            batch = links[begin : begin + most]
            drawn.append(draw(batch))
        self._count(poses=len(links))
        return drawn

    @property
    def _trace(self) -> Callable[[int, Float32, Float32], Bool] | None:
        """What traces the rays that decide what is covered, if the body asks for that."""
        return self._hit if self.body.method == "rays" else None

    def _hit(self, link: int, origins: Float32, directions: Float32) -> Bool:
        """Return which rays (N, 3) in a link's frame hit it, (N,)."""
        self._count(rays=len(origins))
        return self.body.scenes.hit(link, origins, directions)

    def _count(self, *, rays: int = 0, poses: int = 0) -> None:
        with self._counting:
            self.rays += rays
            self.poses += poses


def _joined(batches: Sequence[NDArray[S]]) -> NDArray[S]:
    """Return what was drawn in batches as one array; a single one is not copied."""
    return batches[0] if len(batches) == 1 else np.concatenate(batches)


def _like(camera_from_root: Float64, images: NDArray[S]) -> NDArray[S]:
    """Return the only image (H, W) of images (1, H, W) of a single pose (4, 4), all of others."""
    return np.asarray(images[0]) if np.ndim(camera_from_root) == 2 else images


def _check_poses(names: tuple[str, ...], camera_from_root: Float64, joints: Float64) -> None:
    """Raise an InputError for poses that are not (C, 4, 4), joints that are not (C, J) or (J,), or not finite."""
    poses = np.shape(camera_from_root)
    if len(poses) != 3 or poses[1:] != (4, 4) or not isinstance(camera_from_root, np.ndarray):
        raise InputError(f"camera_from_root: expected an array (C, 4, 4), got {described(camera_from_root)}")
    rows = joints.shape if isinstance(joints, np.ndarray) else ()
    if rows[-1:] != (len(names),) or rows[:-1] not in ((), (1,), (poses[0],)):
        expected = f"an array ({poses[0]}, {len(names)}) of {', '.join(names)}"
        raise InputError(f"joints: expected {expected}, got {described(joints)}")
    for name, array in (("camera_from_root", camera_from_root), ("joints", joints)):
        if not np.isfinite(array).all():
            raise InputError(f"{name}: expected finite numbers, got others in {described(array)}")


__all__ = ["NEAR", "Body", "PixelSums", "Renderer"]
