"""Parts of a frame's result: its quality of fit, its expected errors, other modes of its pose; rows for pandas."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any, Final, Literal, Protocol

import numpy as np

from dvrk_cmaes.errors import InputError, missing_library
from dvrk_cmaes.geometry import Float64, Image, Posed, in_parent
from dvrk_cmaes.io.arguments import checked_array
from dvrk_cmaes.io.encode import SIGNIFICANT, Document, rounded_array, rounded_values
from dvrk_cmaes.io.typed_document import Number, Point, SquareOfThree, Transform

POSE_AXES: Final = ("tx", "ty", "tz", "rx", "ry", "rz")
"""Names of the first six axes of a covariance; the joints follow."""

Relation = Literal["mirror twin", "other mode"]

_COLOURS = {"ok": (233, 180, 86), "doubtful": (60, 200, 240), "lost": (0, 94, 213)}  # BGR, of the silhouette's outline
_TIPS = (255, 255, 255)
_FARTHEST_MM = 100.0  # of an expected error of the tips: longer than a wrist with its jaws, by far


@dataclass(frozen=True, eq=False)
class Alternative(Document):
    """Another mode of the frame's pose.

    camera_from_root : (4, 4), m. joints : rad. loss, iou : as in `Quality`. relation : to the result's own mode.
    reading_distance_deg : root mean square of the distances from the readings, over the joints read; None without any.
    """

    camera_from_root: Transform
    joints: dict[str, Number]
    loss: Number
    iou: Number
    relation: Relation
    reading_distance_deg: Number | None = None


@dataclass(frozen=True)
class Quality(Document):
    """Agreement of the silhouette with the mask; distances of their contours in px of the full image.

    iou : intersection over union. loss : weighted sum of ``terms``, the terms of the search's loss by name.
    contour_px_median, contour_px_95 : median and 95th percentile of the distances.
    bend_px : deviation of the silhouette from a straight line at which the mask ends; 0 where it ends at none.
    steady_share : share of the contour on stretches that are off together, such as a shadow beside the shaft.
    distal_px : root mean square of the distances (of at most 15 px) beyond the shaft, at wrist and jaws.
    """

    iou: Number
    loss: Number
    terms: dict[str, Number]
    contour_px_median: Number
    contour_px_95: Number
    bend_px: Number = 0.0
    steady_share: Number = 0.0
    distal_px: Number = 0.0


def std_document(covariance: Float64, joints: Sequence[str]) -> dict[str, Any]:
    """Return the standard deviations of a covariance (6 + J, 6 + J), m and rad, in mm and degrees, ready for JSON."""
    sigma = np.sqrt(np.diag(covariance))
    return {
        "translation_mm": rounded_array(sigma[:3] * 1e3),
        "rotation_deg": rounded_array(np.degrees(sigma[3:6])),
        "joints_deg": rounded_values(dict(zip(joints, np.degrees(sigma[6:]).tolist(), strict=True))),
    }


@dataclass(frozen=True, eq=False)
class ViewCheck(Document):
    """Fit of the pose in one view of a rig, and how far the view contradicts the first one.

    name : of the view. quality : in this view alone. rotation_deg : (3,) rotation of the view about the first camera's
    axes with which its mask would fit the pose best, degrees; zero for the first view. covariance_deg2 : (3, 3), of it.
    """

    name: str
    quality: Quality
    rotation_deg: Point
    covariance_deg2: SquareOfThree = field(metadata=SIGNIFICANT)

    @property
    def significance(self) -> float:
        """Length of the rotation in standard deviations; 0 for the first view."""
        if not self.rotation_deg.any():
            return 0.0
        return float(np.sqrt(self.rotation_deg @ np.linalg.solve(self.covariance_deg2, self.rotation_deg)))


@dataclass(frozen=True, eq=False)
class ExpectedError(Document):
    """Standard deviations of the tips and of the shaft's direction, from the covariance of pose and joints.

    They are those in metres, with the errors of the camera's file; `tip_90_given_camera_mm` is without these, as counts
    where a pose is compared with others in the same camera, such as in visual servoing. The tips are ``jaw_1``,
    ``jaw_2`` and their ``mean``, or ``tip`` of an instrument without a pair of jaws.

    tip_mm : root mean square of each tip's distance from its true position, mm.
    tip_axes_mm : (3,) standard deviations of each tip along the camera's axes, mm.
    tip_covariance_mm2 : (3, 3) covariance of each tip's position, of which these are the diagonal, mm^2; empty in older
        files.
    tip_90_mm : distance within which each single tip lies with a probability of 90 %, mm.
    tip_90_given_camera_mm : the same if the camera's file is right; None where it is not stated.
    shaft_deg : root mean square of the angle between the shaft's direction and the true one, degrees.
    """

    tip_mm: dict[str, Number]
    tip_axes_mm: dict[str, Point]
    tip_90_mm: Number
    shaft_deg: Number
    tip_90_given_camera_mm: Number | None = None
    tip_covariance_mm2: dict[str, SquareOfThree] = field(default_factory=dict, repr=False)

    @property
    def of_tips_mm(self) -> float:
        """Expected error of the tips as a whole, mm: of their mean, or of the only tip."""
        return self.tip_mm["mean" if "mean" in self.tip_mm else "tip"]

    @property
    def determined(self) -> bool:
        """Whether the tips are stated within a distance that they can have from a wrist."""
        return self.tip_90_mm <= _FARTHEST_MM

    @property
    def in_words(self) -> str:
        """The distance within which the tips lie, for people: ``tips within 0.62 mm (90 %)``.

        Where they are not determined, the mask has no information on them.
        """
        if not self.determined:
            return "tips not determined: the mask shows no wrist"
        given = self.tip_90_given_camera_mm
        in_camera = "" if given is None else f", {_short(given)} mm given the camera"
        return f"{'tips' if len(self.tip_mm) > 1 else 'tip'} within {_short(self.tip_90_mm)} mm (90 %{in_camera})"


def _short(value: float) -> str:
    """Return a distance, mm, in the digits that count."""
    return f"{value:.{2 if value < 1 else 1}f}"


class Stated(Protocol):
    """A pose and joints by name, as of a result or of its alternatives."""

    @property
    def camera_from_root(self) -> Float64 | None:
        """Pose of the root link (4, 4), m; None without one."""

    @property
    def joints(self) -> Mapping[str, float]:
        """Joint values, rad."""


class PoseShown:
    """What the results of a frame and of an image of a recording have in common: a covariance, and one line of text."""

    status: str
    reasons: tuple[str, ...]
    camera_from_root: Float64 | None
    joints: dict[str, float]
    covariance: Float64 | None
    renderer: Any

    def __getstate__(self) -> dict[str, Any]:
        """Pickle all but the renderer, which has the meshes."""
        return {**self.__dict__, "renderer": None}

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes of ``covariance``: tx, ty, tz (m), rx, ry, rz (rad), then the joints (rad)."""
        return (*POSE_AXES, *self.joints)

    def covariance_in_camera(self) -> Float64 | None:
        """Return the covariance (6 + J, 6 + J) with its first six axes along and about the camera's, m and rad.

        None without a covariance.
        """
        if self.camera_from_root is None or self.covariance is None:
            return None
        return in_parent(self.camera_from_root, self.covariance)

    def overlay(self, image: Image, renderer: Any = None) -> Image:
        """Return an image with the outline of the pose, (H, W, 3) uint8 BGR, the order of the image given.

        The outline is blue where the result is ok, yellow where it is doubtful, and red where it is lost.

        Parameters
        ----------
        image
            (H, W, 3) uint8 BGR, as OpenCV reads it, or grey (H, W), of the first camera, in any size of its aspect.
        renderer
            Of the instrument in the camera, for a result that was read from a file or unpickled.

        Raises
        ------
        InputError
            No such image, one of another aspect, or a pose without a renderer.
        """
        import cv2  # here, since it takes a seventh of a second and most who read results draw nothing

        given = checked_array("image", image, np.uint8, "an image (H, W, 3) of uint8, BGR, or a grey one (H, W)")
        if given.ndim not in (2, 3) or given.shape[2:] not in ((), (3,)) or not given.size:
            raise InputError(f"image: expected (H, W, 3) BGR or (H, W), got an array of shape {given.shape}")
        drawn = np.array(given if given.ndim == 3 else np.repeat(given[..., None], 3, axis=2), np.uint8, order="C")
        if self.camera_from_root is None:
            return drawn
        renderer = renderer or self.renderer
        if renderer is None:
            raise InputError("overlay: expected renderer=Renderer(body, camera) for a result that was read from a file")
        (height, width), camera = drawn.shape[:2], renderer.camera
        if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):  # more than a pixel
            size = f"{camera.width} x {camera.height}, the camera's"
            raise InputError(f"image: expected {size}, or another size of that aspect, got {width} x {height}")
        mask = renderer.at(width, height).masks(self.camera_from_root, self.joints)
        thick = max(round(width / 400), 1)
        beyond = 4 * thick  # px, so that no line is drawn where the silhouette leaves the image
        padded = cv2.copyMakeBorder(mask.astype(np.uint8), beyond, beyond, beyond, beyond, cv2.BORDER_REPLICATE)
        lines, _ = cv2.findContours(padded, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE, offset=(-beyond, -beyond))
        cv2.drawContours(drawn, lines, -1, (0, 0, 0), 3 * thick, cv2.LINE_AA)
        cv2.drawContours(drawn, lines, -1, _COLOURS.get(self.status, _TIPS), thick, cv2.LINE_AA)
        return drawn

    def _in_one_line(self, name: str, tips: str) -> str:
        """Return status, pose, joints and reasons in the units of reports, after a name and before what tips are."""
        said = [name, self.status]
        if self.camera_from_root is not None:
            said.append(f"position_mm={np.round(self.camera_from_root[:3, 3] * 1e3, 2).tolist()}")
            said.append(f"joints_deg={ {joint: round(math.degrees(at), 2) for joint, at in self.joints.items()} }")
        reasons = f"reasons={list(self.reasons)}" if self.reasons else ""
        return f"{type(self).__name__}({', '.join(filter(None, [*said, tips, reasons]))})"


def posed(stated: Stated, names: Sequence[str]) -> Posed:
    """Return a pose that is stated with the joints of some names in their order; there must be one."""
    assert stated.camera_from_root is not None
    return Posed(stated.camera_from_root, np.array([stated.joints[name] for name in names]))


def data_frame(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Return rows with equal columns as a pandas DataFrame.

    Raises
    ------
    InputError
        pandas is not installed.
    """
    try:
        from pandas import DataFrame
    except ImportError:
        raise missing_library("to_frame", "pandas") from None
    return DataFrame([dict(row) for row in rows])


def html_table(rows: Iterable[Iterable[object]]) -> str:
    """Return rows of cells as a table in HTML, without those whose last cell is None."""
    kept = [cells for cells in map(tuple, rows) if cells[-1] is not None]
    lines = ("".join(f"<td>{escape(str(cell))}</td>" for cell in cells) for cells in kept)
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"
