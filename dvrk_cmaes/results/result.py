"""The result of one frame, and its JSON document in the documented schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes._version import __version__
from dvrk_cmaes.io.rounding import rounded, rounded_array, rounded_matrix, rounded_values
from dvrk_cmaes.io.typed_document import (
    Count,
    Number,
    Texts,
    Transform,
    check_schema,
    convert_document,
    present_fields,
    read_covariance,
    refused,
)

Float64 = NDArray[np.float64]
Status = Literal["ok", "doubtful", "failed"]
Relation = Literal["mirror twin", "other mode"]
Source = Literal["frame", "session"]

SCHEMA = 1
POSE_AXES: Final = ("tx", "ty", "tz", "rx", "ry", "rz")
"""Names of the first six axes of a covariance; the joints follow."""


_LEAST: Final[Mapping[str, Any]] = {
    "frame": "",
    "status": "ok",
    "reasons": (),
    "instrument": "",
    "root_link": "roll_link",
    "camera_from_root": None,
    "joints": None,
    "readings": {},
    "seconds": None,
}
"""Values of fields that are missing in a document; null for ``joints`` and ``seconds`` is refused."""


@dataclass(frozen=True, eq=False)
class Alternative:
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

    def to_dict(self) -> dict[str, Any]:
        """Return the alternative in the result's schema."""
        return {
            "camera_from_root": rounded_array(self.camera_from_root),
            "joints": rounded_values(self.joints),
            "loss": rounded(self.loss),
            "iou": rounded(self.iou),
            "relation": self.relation,
            "reading_distance_deg": None if self.reading_distance_deg is None else rounded(self.reading_distance_deg),
        }


@dataclass(frozen=True)
class Quality:
    """Agreement of the silhouette with the mask; distances of their contours in px of the full image.

    iou : intersection over union. loss : weighted sum of ``terms``, the terms of the search's loss by name.
    contour_px_median, contour_px_95 : median and 95th percentile of the distances.
    bend_px : deviation of the silhouette from a straight line at which the mask ends; 0 where it ends at none.
    """

    iou: Number
    loss: Number
    terms: dict[str, Number]
    contour_px_median: Number
    contour_px_95: Number
    bend_px: Number = 0.0


@dataclass(frozen=True, eq=False)
class Result:
    """Pose and joint values of the instrument in one frame, with their uncertainty.

    camera_from_root : (4, 4), maps points of the root link to the camera's frame, m; None where the frame failed.
    joints : corrected joint values, rad. readings : those given, rad or m.
    reasons : of a doubtful or failed status. warnings : remarks on the inputs. unused : evidence not used, and why.
    camera_from_base : (4, 4), m, where the readings of the outer joints were given.
    source : whether the frame was solved by itself or with its session. change : from the former to the latter.
    covariance : (6 + J, 6 + J), of [tx ty tz rx ry rz] in the root link's axes (m, rad), then of the joints (rad).
    alternatives : other modes, by decreasing likelihood.
    seconds : from arrays in memory to the result. evaluations, rays : silhouettes computed and rays traced.
    """

    frame: str
    status: Status
    reasons: Texts
    instrument: str
    root_link: str
    camera_from_root: Transform | None
    joints: dict[str, Number]
    readings: dict[str, Number]
    warnings: Texts = ()
    unused: Texts = ()
    camera_from_base: Transform | None = None
    source: Source = "frame"
    change: dict[str, Any] | None = None
    quality: Quality | None = None
    covariance: Float64 | None = None
    alternatives: tuple[Alternative, ...] = ()
    seconds: Number = 0.0
    evaluations: Count = 0
    rays: Count = 0
    seed: Count = 0
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
        """Return the result of a frame without a pose; ``reason`` states why, on one line."""
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
        """Read a result from a document in the schema of ``to_dict``.

        ``camera_from_root`` (null for a failed frame), ``joints`` and ``seconds`` are required; the other fields have
        defaults. Standard deviations follow from the covariance; unknown fields are ignored.

        Raises
        ------
        InputError
            Beginning with ``where``: names the field and what was expected.
        """
        fields = present_fields(where, document)
        check_schema(where, fields, SCHEMA)
        covariance = fields.pop("covariance", None)
        if isinstance(fields.get("quality"), dict):
            fields["quality"] = {"terms": {}, **present_fields(where, fields["quality"])}
        result = convert_document(where, {**_LEAST, **fields}, cls)
        if result.camera_from_root is None and result.status != "failed":
            raise refused(where, "camera_from_root", "4 rows of 4 finite numbers", None)
        if covariance is None:
            return result
        return replace(result, covariance=read_covariance(where, covariance, (*POSE_AXES, *result.joints)))

    @property
    def std_translation_mm(self) -> Float64 | None:
        """Standard deviations of the position along the root link's axes, (3,) mm."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)[:3]) * 1e3

    @property
    def std_rotation_deg(self) -> Float64 | None:
        """Standard deviations of the rotation about the root link's axes, (3,) degrees."""
        return None if self.covariance is None else np.degrees(np.sqrt(np.diag(self.covariance)[3:6]))

    @property
    def std_joints_deg(self) -> dict[str, float] | None:
        """Standard deviations of the joints, degrees, by name."""
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
                "joints_deg": rounded_values(self.std_joints_deg or {}),
            }
        covariance = None
        if self.covariance is not None:
            axes = [*POSE_AXES, *self.joints]
            covariance = {"axes": axes, "matrix": rounded_matrix(self.covariance)}
        quality = None
        if self.quality is not None:
            quality = {
                "iou": rounded(self.quality.iou),
                "loss": rounded(self.quality.loss),
                "terms": rounded_values(self.quality.terms),
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
            "joints": rounded_values(self.joints),
            "readings": rounded_values(self.readings),
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
