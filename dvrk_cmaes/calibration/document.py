"""The calibration of a session, and its document, ``session.json``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.blocks import BASE_AXES, OUTER_OFFSETS, Calibration, FoundBlock
from dvrk_cmaes.calibration.cables import SessionCables
from dvrk_cmaes.calibration.endoscope import Endoscope
from dvrk_cmaes.calibration.lag import LagCurve
from dvrk_cmaes.calibration.masks_and_sizes import MARGIN, taken_off
from dvrk_cmaes.calibration.model import (
    ROLL,
    Correction,
    SessionModel,
    ecm_readings,
    spread_names,
)
from dvrk_cmaes.calibration.session_camera import CAMERA, turns_of
from dvrk_cmaes.calibration.session_endoscope import SessionEndoscope
from dvrk_cmaes.calibration.session_frame import changed
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.rig import V, ViewDocument, turned_views
from dvrk_cmaes.config import CameraConfig, ReadingSigmas, __version__
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, adjoint, inverse
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.encode import SIGNIFICANT, encoded_fields, rounded, rounded_array, rounded_matrix
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.typed_document import (
    Count,
    Number,
    PositiveNumber,
    SquareOfSix,
    Texts,
    Transform,
    convert_document,
    present_fields,
    read_covariance,
    refused,
)
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.pose.expected_error import file_covariance

SCHEMA = 5
CALIBRATION_EXPECTED = "a SessionCalibration (dvrk_cmaes.read_calibration reads one)"
"""What messages about arguments say of the type."""
_OTHERWISE = {"axes", "covariance", "covariance_given_camera", "seconds", "config"}
"""Fields that the document has in another form."""
_ELSEWHERE = np.deg2rad(30.0)  # from the only reading of a joint, where its offset says nothing any more


@dataclass(frozen=True)
class Agreement:
    """Intersection over union of a mask and a predicted silhouette, and median distance of their contours, px."""

    iou: Number
    contour_px: Number


@dataclass(frozen=True, eq=False)
class SessionCalibration:
    """Base pose and joint offsets estimated from all frames of a session.

    camera_from_base : (4, 4) m; its translation is the remote centre of motion in the camera.
    offsets : by joint, rad or m: true = reading + offset.
    covariance : (K, K) in the order of ``axes``: small changes of camera_from_base along and about the base's axes,
    then the offsets. It includes the effect of errors of the camera file.
    covariance_given_camera : (K, K) without that effect and that of errors that all masks share, for predictions in
    images of the same camera, to which the latter are added.
    spreads : standard deviations from frame to frame, by joint and of the pose's ``slack``, rad and m.
    frames : names of the frames used. left_out : reasons for leaving out the others, by frame.
    leave_one_out : by frame, how its mask agrees with the silhouette at the pose that the other frames predict.
    iou, contour_px_95 : medians over the frames used, of the silhouettes at the poses of the joint solution.
    lag : lag of the images behind the readings; None if the session does not determine it.
    lag_curve : disagreement of the frames as a function of the lag; None if no lag was searched.
    cables : coupling, play and wander of the cables; None if offsets explain the session as well.
    camera_errors : (6, 6) covariance of camera and size with which the session was solved, by file and frames, in the
    order of `PARAMETERS`.
    blocks : what was found of what the views show, by block: the camera, if it was tested, its lens, the margin of the
    masks, the sizes of the instrument, and the rotation of each further view against the rig's file. The solution
    leaves at zero what is not applied.
    views : the cameras and their places with which the session was solved; empty of frames in memory.
    endoscope : where an endoscope that moved stood, and the camera in its tip; None if it stood still. The base is then
    that at the reference place.
    commanded : the only reading, rad, of each joint whose readings never move while the arm does; offsets hold there.
    undetermined : descriptions of what the session does not determine.
    doubts : what is wrong with the session as a whole and was not put right: every result that rests on it is doubtful.
    remarks : what was found and put right, or is unusual, as of the camera's file; they make nothing doubtful.
    """

    instrument: str
    camera_from_base: Transform
    offsets: dict[str, Number]
    axes: Texts
    covariance: Float64
    covariance_given_camera: Float64
    spreads: dict[str, PositiveNumber]
    frames: Texts = ()
    left_out: dict[str, str] = field(default_factory=dict)
    leave_one_out: dict[str, Agreement] = field(default_factory=dict)
    iou: Number = 0.0
    contour_px_95: Number = 0.0
    lag: Lag | None = None
    lag_curve: LagCurve | None = None
    cables: SessionCables | None = None
    blocks: dict[str, FoundBlock] = field(default_factory=dict)
    camera_errors: SquareOfSix = field(
        default_factory=partial(file_covariance, None, CameraConfig()), metadata=SIGNIFICANT
    )
    views: tuple[ViewDocument, ...] = ()
    endoscope: SessionEndoscope | None = None
    commanded: dict[str, Number] = field(default_factory=dict)
    undetermined: Texts = ()
    doubts: Texts = ()
    remarks: Texts = ()
    arm: Arm = "classic"
    roll_offset: Number = 0.0
    seconds: Number = 0.0
    seed: Count = 0
    version: str = __version__
    config: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Show the status, the base, the offsets and how well frames are predicted; all fields are in `to_dict`."""
        base, offsets = (1e3 * self.rcm).round(2).tolist(), {name: round(at, 4) for name, at in self.offsets.items()}
        found = f"base_mm={base}, {offsets=}, predicted_iou={self.predicted_iou:.3f}"
        return f"SessionCalibration({self.status}, {self.instrument!r}, {len(self.frames)} frames, {found})"

    @property
    def rcm(self) -> Float64:
        """Remote centre of motion in the camera, (3,) m."""
        return np.asarray(self.camera_from_base[:3, 3])

    def corrected(self, camera: Camera) -> Camera:
        """Return the camera with the change with which the session was solved; the camera itself if there is none.

        Parameters
        ----------
        camera
            The camera as its file has it.
        """
        found = self.blocks.get(CAMERA)
        return changed(camera, np.array(found.values)) if found is not None and found.applied else camera

    def corrected_views(self, views: Sequence[V]) -> tuple[V, ...]:
        """Return the views of a rig or frame with which the session was solved: all cameras `corrected`, some changed.

        The views keep what they hold besides their camera.

        Parameters
        ----------
        views
            The views as the cameras' files have them.
        """
        own = tuple(replace(view, camera=self.corrected(view.camera)) for view in views)
        return turned_views(own, turns_of(self.blocks))

    @property
    def predicted_iou(self) -> float:
        """Mean overlap of the frames' masks with what the other frames predict of them; 1 if none was predicted."""
        return float(np.mean([one.iou for one in self.leave_one_out.values()] or [1.0]))

    @property
    def predicted_px(self) -> float:
        """Median distance, px, of the frames' contours from what the other frames predict; 0 if none was predicted."""
        return float(np.median([one.contour_px for one in self.leave_one_out.values()] or [0.0]))

    @property
    def margin_px(self) -> float:
        """Margin, px, that is taken off the masks."""
        return taken_off(self.blocks.get(MARGIN))

    @property
    def applied_lag(self) -> Lag | None:
        """The lag that was taken out of the readings; None if none was."""
        return self.lag if self.lag is not None and self.lag.applied else None

    @property
    def status(self) -> str:
        """``doubtful`` if there are doubts about the session as a whole, ``ok`` otherwise."""
        return "doubtful" if self.doubts else "ok"

    @property
    def warnings(self) -> Texts:
        """All doubts and remarks, the doubts first."""
        return (*self.doubts, *self.remarks)

    def in_words(self) -> Iterator[str]:
        """Yield what the frames show besides base, offsets and cables, in words: endoscope, lag, cameras, masks."""
        yield from () if self.endoscope is None else self.endoscope.in_words()
        if self.lag is not None:
            taken = f"taken out of the readings (of other commands: {self.lag.option})"
            done = taken if self.lag.applied else "zero within its error, not taken out"
            yield f"lag: {self.lag.describe()}; {done}"
        yield from (block.text for block in self.blocks.values())

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration in the documented schema, ready for JSON."""
        std = np.sqrt(np.diag(self.covariance))
        return {
            "schema": SCHEMA,
            **encoded_fields(self, "status", "rcm"),
            "std": {
                "base_translation_mm": rounded_array(std[:3] * 1e3),
                "base_rotation_deg": rounded_array(np.degrees(std[3:6])),
                "offsets": {name: rounded(value) for name, value in zip(self.offsets, std[6:], strict=True)},
            },
            "covariance": {
                "axes": list(self.axes),
                "matrix": rounded_matrix(self.covariance),
                "given_camera": rounded_matrix(self.covariance_given_camera),
            },
            "warnings": list(self.warnings),
            **encoded_fields(self, *(one.name for one in fields(self) if one.name not in _OTHERWISE)),
            "seconds": round(self.seconds, 3),
            "config": self.config,
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], *, where: str = "session") -> SessionCalibration:
        """Read a calibration from its document.

        Parameters
        ----------
        document
            The content of session.json.
        where
            Where it is from, for messages.

        Raises
        ------
        InputError
            A field that is missing or wrong; the message begins with ``where``.
        """
        fields = {"instrument": "", "version": "", **present_fields(where, document)}
        if (schema := fields.get("schema")) != SCHEMA:
            got = "none" if schema is None else shown(schema)
            again = "calibrate again: dvrk-cmaes calibrate FOLDER"
            raise InputError(f"{where}: schema: expected {SCHEMA}, got {got}; {again}")
        covariance, endoscope = fields.pop("covariance", None), fields.pop("endoscope", None)
        without = {"axes": (), "covariance": np.zeros((0, 0)), "covariance_given_camera": np.zeros((0, 0))}
        found = convert_document(where, {**fields, **without}, cls)
        axes = (*BASE_AXES, *found.offsets)
        found = replace(
            found,
            axes=axes,
            covariance=read_covariance(where, covariance, axes),
            covariance_given_camera=read_covariance(where, covariance, axes, "given_camera"),
            endoscope=SessionEndoscope.from_document(where, endoscope, len(axes)),
        )
        if found.lag is not None and found.lag.frames is None and found.lag.seconds is None:
            raise refused(where, "lag", "frames or seconds", fields["lag"])
        if found.cables is not None:
            found.cables.check(where, tuple(found.offsets)[1:])
        count = len(found.whole_covariance)
        for name, block in found.blocks.items():
            if len(block.moves) not in (0, count) or {*map(len, block.moves)} - {len(block.values)}:
                raise refused(where, f"blocks.{name}.moves", f"{count} rows of {len(block.values)}", block.moves)
        return found

    def at(
        self, readings: Mapping[str, float], *, frame: str = "", time: float | None = None
    ) -> SessionCalibration | str:
        """Return the calibration of a camera that stands still where the endoscope is in a frame.

        That is the calibration itself, unless the endoscope moved. Returns a text that says why the place is not known.

        Parameters
        ----------
        readings
            All readings of the frame by joint name, rad and m; those of the endoscope's arm show the place.
        frame
            Name of the frame, which shows the place of an endoscope that is not read where no times are known.
        time
            Time of the frame's image, s, by which that place is found.
        """
        if self.endoscope is None:
            return self
        endoscope = self.endoscope.in_frames(self.camera_from_base, ecm_readings([readings]), [time], [frame])
        if isinstance(endoscope, str):
            return endoscope
        count, covariance = len(self.axes), self.endoscope.covariance
        relative, by_values, own = (one[0] for one in endoscope.relative(endoscope.start))
        base_from_camera = adjoint(inverse(self.camera_from_base))
        move, own = np.eye(count, len(covariance)), base_from_camera @ own
        move[:6, count:] = base_from_camera @ by_values
        given_camera = move @ covariance @ move.T
        given_camera[:6, :6] += own @ own.T
        return replace(
            self,
            camera_from_base=relative @ self.camera_from_base,
            covariance=given_camera + self.covariance - self.covariance_given_camera,
            covariance_given_camera=given_camera,
            blocks={name: block.after(move) for name, block in self.blocks.items()},
            endoscope=None,
        )

    @property
    def whole_covariance(self) -> Float64:
        """Covariance (K + M, K + M) for predictions in images of the same camera, with M unknowns of the endoscope."""
        return self.covariance_given_camera if self.endoscope is None else self.endoscope.covariance

    def model(
        self, outer: Float64, joints: Float64, joint_names: tuple[str, ...], endoscope: Endoscope | None = None
    ) -> tuple[SessionModel, Calibration]:
        """Return the session model for readings (N, 4) and (N, J) of other frames, and the calibration.

        Of the cables, it has what the reading of a frame alone shows. The standard deviations of commanded joints are
        wider in frames with other readings than those of the session. ``endoscope`` is where it is in the frames, as of
        `SessionEndoscope.in_frames`; without it, the base is that at the reference place.

        Raises
        ------
        InputError
            The calibration was made with an instrument with other joints.
        """
        names = (*OUTER_OFFSETS, *joint_names)
        if tuple(self.offsets) != names:
            raise InputError(
                f"session: offsets: expected those of {', '.join(names)}, got {', '.join(self.offsets) or 'none'}"
            )
        needed = spread_names(joint_names)
        missing = [name for name in needed if name not in self.spreads]
        if missing:
            raise InputError(f"session: spreads: expected those of {', '.join(needed)}, got no {', '.join(missing)}")
        *of_joints, translation, rotation = (self.spreads[name] for name in needed)
        deviations = np.array([*of_joints, *[translation] * 3, *[rotation] * 3])
        offsets = np.array(list(self.offsets.values()))
        correction = Correction.none(*joints.shape)
        if self.cables is not None:
            deviations[ROLL:-6] = self.cables.alone.noise
            offsets[1:] = self.cables.alone.offset
            correction = self.cables.correction_alone(np.concatenate([outer[:, 3:], joints], axis=1))
        model = SessionModel(
            outer=outer,
            joints=joints,
            names=joint_names,
            usual=deviations,
            deviations=deviations,
            arm=self.arm,
            roll_offset=self.roll_offset,
            inflation=self._elsewhere(joints, joint_names, deviations[ROLL + 1 : -6]),
            correction=correction,
            offset_std=np.full(len(names), np.inf),
            endoscope=endoscope,
        )
        return model, model.calibration(self.camera_from_base, offsets)

    def _elsewhere(self, joints: Float64, joint_names: Sequence[str], std: Float64) -> Float64:
        """Return the factors (N, 1 + J) on the standard deviations ``std`` (J,), rad, of roll and joints (N, J).

        The error of a reading far from a commanded one is as that of a joint of which nothing is known, up to there in
        proportion to the distance.
        """
        constant = np.array([self.commanded.get(name, np.nan) for name in joint_names])
        usual = np.deg2rad([ReadingSigmas().of(name) for name in joint_names])
        away = usual * np.minimum(np.abs(np.nan_to_num(joints - constant)) / _ELSEWHERE, 1.0)
        return np.column_stack([np.ones(len(joints)), np.sqrt(1 + (away / std) ** 2)])


def check_made_for(where: str, calibration: SessionCalibration, instrument: str, arm: Arm | None = None) -> None:
    """Raise `InputError` for a calibration of an instrument of another name, or of another arm, if that is given."""
    if calibration.instrument not in ("", instrument):
        raise refused(where, "instrument", f"a calibration of {shown(instrument)}", calibration.instrument)
    if arm not in (None, calibration.arm):
        raise refused(where, "arm", f"a calibration of an arm {shown(arm)}", calibration.arm)


def read_calibration(path: str | Path) -> SessionCalibration:
    """Read a session's calibration; InputError names the file and the field.

    Parameters
    ----------
    path
        The file, session.json.
    """
    document = read_json_object(path, expected="a session calibration (session.json)")
    return SessionCalibration.from_dict(document, where=str(path))
