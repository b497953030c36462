"""What an estimate returns: a typed object, and its JSON in the documented schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes._version import __version__
from dvrk_cmaes.io.fields import Fields, rounded, rounded_array

Float64 = NDArray[np.float64]
Status = Literal["ok", "doubtful", "failed"]
Relation = Literal["mirror twin", "other mode"]
Source = Literal["frame", "session"]

SCHEMA = 1
POSE_AXES: Final = ("tx", "ty", "tz", "rx", "ry", "rz")
"""Order of a covariance's axes, before the joints."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another pose that explains the frame.

    ``reading_distance_deg`` is the root mean square over the joints read, None without readings.
    """

    camera_from_root: Float64
    joints: dict[str, float]
    loss: float
    iou: float
    relation: Relation
    reading_distance_deg: float | None

    def to_dict(self) -> dict[str, Any]:
        """Return the alternative in the result's schema."""
        return {
            "camera_from_root": rounded_array(self.camera_from_root),
            "joints": _values(self.joints),
            "loss": rounded(self.loss),
            "iou": rounded(self.iou),
            "relation": self.relation,
            "reading_distance_deg": None if self.reading_distance_deg is None else rounded(self.reading_distance_deg),
        }


@dataclass(frozen=True)
class Quality:
    """How well the silhouette explains the mask; contour distances in px of the full image.

    ``bend_px``: how far the silhouette bends along a straight line that ends the mask; 0 where none does.
    """

    iou: float
    loss: float
    terms: dict[str, float]
    contour_px_median: float
    contour_px_95: float
    bend_px: float = 0.0


@dataclass(frozen=True, eq=False)
class Result:
    """Pose and joints of the instrument in one frame, and how far they can be trusted.

    camera_from_root : (4, 4), maps points of the root link into the camera's frame, m; None where the frame failed.
    joints : corrected joint values, rad. readings : those given, rad or m.
    covariance : of [tx ty tz rx ry rz] in the root link's axes (m, rad), then the joints (rad).
    std_translation_mm, std_rotation_deg : (3,) each, in the same axes.
    camera_from_base : (4, 4) where the outer arm's readings were given.
    seconds : from arrays in memory to result.
    """

    frame: str
    status: Status
    reasons: tuple[str, ...]
    instrument: str
    root_link: str
    camera_from_root: Float64 | None
    joints: dict[str, float]
    readings: dict[str, float]
    warnings: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()
    camera_from_base: Float64 | None = None
    source: Source = "frame"
    change: dict[str, Any] | None = None
    quality: Quality | None = None
    covariance: Float64 | None = None
    alternatives: tuple[Alternative, ...] = ()
    seconds: float = 0.0
    evaluations: int = 0
    rays: int = 0
    seed: int = 0
    version: str = ""
    config: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def failed(
        cls,
        frame: str,
        reason: str,
        readings: Mapping[str, float],
        *,
        instrument: str,
        root_link: str,
        warnings: Sequence[str] = (),
        seed: int = 0,
        config: Mapping[str, Any] | None = None,
    ) -> Result:
        """Return the result of a frame for which there is no pose; ``reason`` says why, on one line."""
        return cls(
            frame=frame,
            status="failed",
            reasons=(reason,),
            instrument=instrument,
            root_link=root_link,
            camera_from_root=None,
            joints={},
            readings=dict(readings),
            warnings=tuple(warnings),
            seed=seed,
            version=__version__,
            config=dict(config or {}),
        )

    @classmethod
    def from_dict(cls, document: object, *, where: str = "result") -> Result:
        """Take a result from a document in the schema of ``to_dict``.

        Only ``camera_from_root`` (null for a failed frame), ``joints`` and ``seconds`` must be there; the rest has
        defaults. Standard deviations follow from the covariance; fields of other names are not looked at.

        Raises
        ------
        InputError
            Beginning with ``where``: names the field and what was expected.
        """
        fields = Fields.of(where, document)
        if fields.count("schema", SCHEMA) != SCHEMA:
            raise fields.refuse("schema", f"{SCHEMA}, the only one known to this version")
        status = cast(Status, fields.choice("status", get_args(Status), "ok"))
        joints = fields.numbers("joints", required=True)
        change, config = fields.inner("change"), fields.inner("config")
        return cls(
            frame=fields.text("frame"),
            status=status,
            reasons=fields.texts("reasons"),
            instrument=fields.text("instrument"),
            root_link=fields.text("root_link", "roll_link"),
            camera_from_root=fields.pose("camera_from_root", required=status != "failed"),
            joints=joints,
            readings=fields.numbers("readings"),
            warnings=fields.texts("warnings"),
            unused=fields.texts("unused"),
            camera_from_base=fields.pose("camera_from_base"),
            source=cast(Source, fields.choice("source", get_args(Source), "frame")),
            change=None if change is None else dict(change.values),
            quality=_quality(fields.inner("quality")),
            covariance=_covariance(fields.inner("covariance"), joints),
            alternatives=tuple(_alternative(entry) for entry in fields.inners("alternatives")),
            seconds=fields.number("seconds"),
            evaluations=fields.count("evaluations"),
            rays=fields.count("rays"),
            seed=fields.count("seed"),
            version=fields.text("version"),
            config={} if config is None else dict(config.values),
        )

    @property
    def std_translation_mm(self) -> Float64 | None:
        """Standard deviations along the root's axes, (3,) mm."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)[:3]) * 1e3

    @property
    def std_rotation_deg(self) -> Float64 | None:
        """Standard deviations about the root's axes, (3,) degrees."""
        return None if self.covariance is None else np.degrees(np.sqrt(np.diag(self.covariance)[3:6]))

    @property
    def std_joints_deg(self) -> dict[str, float] | None:
        """Standard deviations of the joints, degrees."""
        if self.covariance is None:
            return None
        sigma = np.degrees(np.sqrt(np.diag(self.covariance)[6:]))
        return dict(zip(self.joints, sigma.tolist(), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Return the result in the documented schema, ready for JSON."""
        std = None
        if self.std_translation_mm is not None and self.std_rotation_deg is not None:
            std = {
                "translation_mm": rounded_array(self.std_translation_mm),
                "rotation_deg": rounded_array(self.std_rotation_deg),
                "joints_deg": _values(self.std_joints_deg or {}),
            }
        covariance = None
        if self.covariance is not None:
            axes = [*POSE_AXES, *self.joints]
            covariance = {"axes": axes, "matrix": [[float(f"{v:.6e}") for v in row] for row in self.covariance]}
        quality = None
        if self.quality is not None:
            quality = {
                "iou": rounded(self.quality.iou),
                "loss": rounded(self.quality.loss),
                "terms": _values(self.quality.terms),
                "contour_px_median": rounded(self.quality.contour_px_median),
                "contour_px_95": rounded(self.quality.contour_px_95),
                "bend_px": rounded(self.quality.bend_px),
            }
        return {
            "schema": SCHEMA,
            "frame": self.frame,
            "status": self.status,
            "reasons": list(self.reasons),
            "instrument": self.instrument,
            "root_link": self.root_link,
            "camera_from_root": None if self.camera_from_root is None else rounded_array(self.camera_from_root),
            "joints": _values(self.joints),
            "readings": _values(self.readings),
            "warnings": list(self.warnings),
            "unused": list(self.unused),
            "camera_from_base": None if self.camera_from_base is None else rounded_array(self.camera_from_base),
            "source": self.source,
            "change": self.change,
            "quality": quality,
            "std": std,
            "covariance": covariance,
            "alternatives": [a.to_dict() for a in self.alternatives],
            "seconds": round(self.seconds, 4),
            "evaluations": self.evaluations,
            "rays": self.rays,
            "seed": self.seed,
            "version": self.version,
            "config": self.config,
        }


def _quality(fields: Fields | None) -> Quality | None:
    if fields is None:
        return None
    return Quality(
        iou=fields.number("iou"),
        loss=fields.number("loss"),
        terms=fields.numbers("terms"),
        contour_px_median=fields.number("contour_px_median"),
        contour_px_95=fields.number("contour_px_95"),
        bend_px=fields.number("bend_px", 0.0),
    )


def _covariance(fields: Fields | None, joints: dict[str, float]) -> Float64 | None:
    """Matrix of a covariance, whose axes must be in the documented order."""
    if fields is None:
        return None
    axes = (*POSE_AXES, *joints)
    if fields.texts("axes") != axes:
        raise fields.refuse("axes", ", ".join(axes))
    matrix = fields.array("matrix", (len(axes), len(axes)))
    if matrix is None or (np.diag(matrix) < 0).any():
        raise fields.refuse("matrix", f"{len(axes)} rows of {len(axes)} finite numbers, no negative variance")
    return matrix


def _alternative(fields: Fields) -> Alternative:
    pose = fields.pose("camera_from_root", required=True)
    assert pose is not None
    return Alternative(
        camera_from_root=pose,
        joints=fields.numbers("joints", required=True),
        loss=fields.number("loss"),
        iou=fields.number("iou"),
        relation=cast(Relation, fields.choice("relation", get_args(Relation))),
        reading_distance_deg=fields.number("reading_distance_deg") if fields.has("reading_distance_deg") else None,
    )


def _values(values: dict[str, float]) -> dict[str, float]:
    return {name: rounded(value) for name, value in values.items()}
