"""The result of one frame, and its JSON document in the documented schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.io.encode import encoded, encoded_fields, rounded_matrix
from dvrk_cmaes.io.typed_document import (
    Count,
    Number,
    Pixel,
    Point,
    Texts,
    Transform,
    check_schema,
    convert_document,
    present_fields,
    read_covariance,
    refused,
)
from dvrk_cmaes.results.parts import (
    POSE_AXES,
    Alternative,
    ExpectedError,
    PoseShown,
    Quality,
    ViewCheck,
    data_frame,
    html_table,
    posed,
    std_document,
)

if TYPE_CHECKING:
    from dvrk_cmaes.instrument import Instrument

__all__ = [
    "POSE_AXES",
    "SCHEMA",
    "Alternative",
    "ExpectedError",
    "Quality",
    "Result",
    "Source",
    "Status",
    "ViewCheck",
]

Status = Literal["ok", "doubtful", "failed"]
Source = Literal["frame", "session"]

SCHEMA = 1

_LEAST: Final[Mapping[str, Any]] = {
    "frame": "",
    "status": "ok",
    "reasons": (),
    "instrument": "",
    "root_link": "roll_link",
    "camera_from_root": None,
    "joints": None,
    "readings": {},
}
"""Values of fields that are missing in a document; null for ``joints`` is refused."""


@dataclass(frozen=True, eq=False)
class Result(PoseShown):
    """Pose and joint values of the instrument in one frame, with their uncertainty.

    camera_from_root : (4, 4), maps points of the root link to the camera's frame, m; None where the frame failed.
    joints : corrected joint values, rad. readings : those given, rad or m.
    shaft_radius : of the instrument that was sought, m; None if it has no straight shaft.
    reasons : of a doubtful or failed status. warnings : about this frame's inputs. unused : evidence not used, and why.
    remarks : on the camera's file and the session that the result rests on; they do not decide the status.
    camera_from_base : (4, 4), m, where the readings of the outer joints were given.
    source : whether the frame was solved by itself or with its session. change : from the former to the latter.
    time : of the image, s; None if it is not known.
    tips : (3,) each, m in the camera's frame: jaw_1 and jaw_2, or the end of an instrument without a pair of jaws.
    tips_px : (2,) each, their pixels; empty if one is behind the camera.
    covariance : (6 + J, 6 + J), of [tx ty tz rx ry rz] in the root link's axes (m, rad), then of the joints (rad).
    expected_error : of the tips and the shaft's direction, from the covariance.
    mode_probability : that the pose is in the true mode, not in one of the alternatives' or the mirror twin's.
    tip_probability : that the tips are within the distance ``trust.tip_mm`` of their true positions.
    alternatives : other modes, by decreasing likelihood.
    seconds : from arrays in memory to the result, 0 if not stated.
    evaluations, rays : silhouettes computed and rays traced.
    model : the instrument, for `links`; it is not written to files.
    renderer : of the instrument in the camera, for `overlay`; it is neither written nor pickled.
    """

    frame: str
    status: Status
    reasons: Texts
    instrument: str
    root_link: str
    camera_from_root: Transform | None
    joints: dict[str, Number]
    readings: dict[str, Number]
    shaft_radius: Number | None = None
    warnings: Texts = ()
    remarks: Texts = ()
    unused: Texts = ()
    camera_from_base: Transform | None = None
    source: Source = "frame"
    change: dict[str, Any] | None = None
    quality: Quality | None = None
    time: Number | None = None
    tips: tuple[Point, ...] = ()
    tips_px: tuple[Pixel, ...] = ()
    covariance: Float64 | None = None
    expected_error: ExpectedError | None = None
    mode_probability: Number | None = None
    tip_probability: Number | None = None
    alternatives: tuple[Alternative, ...] = ()
    views: Texts = ()
    view_fits: tuple[ViewCheck, ...] = ()
    seconds: Number = 0.0
    evaluations: Count = 0
    rays: Count = 0
    seed: Count = 0
    version: str = ""
    config: dict[str, Any] = field(default_factory=dict)
    model: Any = field(default=None, repr=False)
    renderer: Any = field(default=None, repr=False)

    def __repr__(self) -> str:
        """Show the status, the pose and the joints, in the units of reports; all fields are in `to_dict`."""
        tips = "" if self.expected_error is None else self.expected_error.in_words
        return self._in_one_line(repr(self.frame) if self.frame else "", tips)

    @classmethod
    def failed(cls, frame: str, reason: str, readings: Mapping[str, float], **fields: Any) -> Result:
        """Return the result of a frame without a pose; ``reason`` states why, on one line.

        Parameters
        ----------
        frame
            Name of the frame.
        reason
            Why there is no pose, on one line.
        readings
            Readings by joint, rad (insertion: m).
        fields
            Other fields of the result: at least ``instrument`` and ``root_link``, the names of both.
        """
        fields |= {"camera_from_root": None, "joints": {}, "version": __version__}
        return cls(frame=frame, status="failed", reasons=(reason,), readings=dict(readings), **fields)

    @classmethod
    def from_dict(cls, document: object, *, where: str = "result") -> Result:
        """Read a result from a document in the schema of ``to_dict``.

        ``camera_from_root`` (null for a failed frame) and ``joints`` are required; the other fields have defaults.
        Standard deviations follow from the covariance; unknown fields are ignored.

        Parameters
        ----------
        document
            The content of a result's JSON file.
        where
            Where it is from, for messages.

        Raises
        ------
        InputError
            Beginning with ``where``: names the field and what was expected.
        """
        fields = present_fields(where, document)
        check_schema(where, fields, SCHEMA)
        covariance = fields.pop("covariance", None)
        std = fields.pop("std", None)
        fields.pop("model", None)
        fields.pop("renderer", None)
        if isinstance(std, dict) and "tip_mm" in std:
            fields["expected_error"] = std
        if isinstance(fields.get("quality"), dict):
            fields["quality"] = {"terms": {}, **present_fields(where, fields["quality"])}
        result = convert_document(where, {**_LEAST, **fields}, cls)
        if result.camera_from_root is None and result.status != "failed":
            raise refused(where, "camera_from_root", "4 rows of 4 finite numbers", None)
        if result.expected_error is not None and not {"mean", "tip"} & set(result.expected_error.tip_mm):
            raise refused(
                where, "std.tip_mm", "that of the tips' mean, or of the only tip", list(result.expected_error.tip_mm)
            )
        if covariance is None:
            return result
        return replace(result, covariance=read_covariance(where, covariance, (*POSE_AXES, *result.joints)))

    @property
    def std_joints_deg(self) -> dict[str, float] | None:
        """Standard deviations of the joints, degrees, by name."""
        if self.covariance is None:
            return None
        sigma = np.degrees(np.sqrt(np.diag(self.covariance)[6:]))
        return dict(zip(self.joints, sigma.tolist(), strict=True))

    def require_pose(self) -> Float64:
        """Return ``camera_from_root`` (4, 4), m.

        Raises
        ------
        DvrkCmaesError
            The frame failed, and has no pose: its reasons.
        """
        if self.camera_from_root is None:
            raise DvrkCmaesError(f"frame {self.frame}: no pose: {'; '.join(self.reasons)}")
        return self.camera_from_root

    def _repr_html_(self) -> str:
        """Show the row of `to_row` as a table in a notebook, a line each column."""
        return html_table(self.to_row().items())

    def to_row(self) -> dict[str, Any]:
        """Return the row of poses.csv: a number, a text or None by column, with the unit in the column's name."""
        from dvrk_cmaes.results.pose_rows import pose_rows

        return pose_rows([self])[0]

    def to_frame(self) -> Any:
        """Return the row of `to_row` as a pandas DataFrame.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        return data_frame([self.to_row()])

    def links(self, instrument: Instrument | None = None) -> dict[str, Float64]:
        """Return camera_from_link (4, 4), m, of each link with geometry by name; empty without a pose.

        ``instrument`` is needed for a result that was read from a file; by default it is the one that was estimated.

        Parameters
        ----------
        instrument
            The instrument of the result, for one that was read from a file.

        Raises
        ------
        InputError
            The instrument is not known, or has a joint that the result does not have.
        """
        if self.camera_from_root is None:
            return {}
        model: Instrument | None = instrument or self.model
        if model is None:
            raise InputError("links: expected the instrument of a result that was read from a file, got none")
        joints, missing = self.joints, [name for name in model.joint_names if name not in self.joints]
        if missing:
            said = f"expected a value of {missing[0]} of {model.name}, got {', '.join(joints)}"
            raise InputError(f"links: joints: {said}")
        poses = self.camera_from_root @ model.forward([joints[name] for name in model.joint_names])
        return {link.name: pose for link, pose in zip(model.links, poses, strict=True)}

    def to_dict(self) -> dict[str, Any]:
        """Return the result in the documented schema, ready for JSON."""
        std, covariance = None, None
        if self.covariance is not None:
            std = std_document(self.covariance, tuple(self.joints)) | (encoded(self.expected_error) or {})
            covariance = {"axes": list(self.axes), "matrix": rounded_matrix(self.covariance)}
        of_rig = ("views", "view_fits") if self.views else ()
        return {
            "schema": SCHEMA,
            **encoded_fields(self, "frame", "time", "status", "reasons", "instrument", "shaft_radius", "root_link"),
            **encoded_fields(self, "camera_from_root", "joints", "readings", "tips", "tips_px", "warnings"),
            **encoded_fields(self, "remarks", "unused"),
            **encoded_fields(self, "camera_from_base", "source"),
            "change": self.change,
            "quality": encoded(self.quality),
            "std": std,
            "covariance": covariance,
            **encoded_fields(self, "mode_probability", "tip_probability", "alternatives"),
            "seconds": round(self.seconds, 4),
            **encoded_fields(self, "evaluations", "rays", "seed", "version"),
            "config": self.config,
            **encoded_fields(self, *of_rig),
        }


def modes_of(result: Result, names: Sequence[str]) -> list[Posed]:
    """Return the pose of a result and its alternatives, with the joints of some names in their order."""
    return [posed(result, names), *(posed(other, names) for other in result.alternatives)]
