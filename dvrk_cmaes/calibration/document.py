"""A session's calibration, and its document, ``session.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes._version import __version__
from dvrk_cmaes.calibration.model import BASE_AXES, OUTER_OFFSETS, Calibration, SessionModel, Spreads
from dvrk_cmaes.calibration.solve import Solution
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.fields import Fields, rounded, rounded_array
from dvrk_cmaes.io.json_file import read_json_object

Float64 = NDArray[np.float64]

SCHEMA = 1
_UNTOLD = 0.9  # of what was expected beforehand: an offset whose standard deviation is as wide was not found
_UNTOLD_TURN = np.deg2rad(5.0)
_UNTOLD_SHIFT = 5e-3  # m


@dataclass(frozen=True, eq=False)
class SessionCalibration:
    """What a session's frames say together.

    camera_from_base : (4, 4) m; its translation is the remote centre of motion in the camera.
    offsets : by joint, rad or m: true = reading + offset.
    covariance : (K, K) in the order of ``axes``: small changes of camera_from_base along and about the base's own
    axes, then the offsets.
    spreads : standard deviations from frame to frame, by joint and of the pose's ``slack``, rad and m.
    frames, left_out : names of those used; the others with the reason. leave_one_out : by frame, overlap and median
    contour distance, px, of what the other frames predict with the frame's mask.
    iou, contour_px_95 : medians over the frames used, solved together.
    untold : what the session cannot tell, in words. lag : of the readings, in frames, and where times are known, in
    seconds.
    """

    instrument: str
    camera_from_base: Float64
    offsets: dict[str, float]
    axes: tuple[str, ...]
    covariance: Float64
    spreads: dict[str, float]
    frames: tuple[str, ...] = ()
    left_out: dict[str, str] = field(default_factory=dict)
    leave_one_out: dict[str, tuple[float, float]] = field(default_factory=dict)
    iou: float = 0.0
    contour_px_95: float = 0.0
    lag: dict[str, float] | None = None
    untold: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    arm: Arm = "classic"
    roll_offset: float = 0.0
    seconds: float = 0.0
    seed: int = 0
    version: str = __version__
    config: dict[str, Any] = field(default_factory=dict)

    @property
    def rcm(self) -> Float64:
        """Remote centre of motion in the camera, (3,) m."""
        return np.asarray(self.camera_from_base[:3, 3])

    @property
    def status(self) -> str:
        """Whether something about the session as a whole is in doubt: ``ok`` or ``doubtful``."""
        return "doubtful" if self.warnings else "ok"

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration in the documented schema, ready for JSON."""
        std = np.sqrt(np.diag(self.covariance))
        return {
            "schema": SCHEMA,
            "status": self.status,
            "instrument": self.instrument,
            "camera_from_base": rounded_array(self.camera_from_base),
            "rcm": rounded_array(self.rcm),
            "offsets": {name: rounded(value) for name, value in self.offsets.items()},
            "std": {
                "base_translation_mm": rounded_array(std[:3] * 1e3),
                "base_rotation_deg": rounded_array(np.degrees(std[3:6])),
                "offsets": {name: rounded(value) for name, value in zip(self.offsets, std[6:], strict=True)},
            },
            "covariance": {
                "axes": list(self.axes),
                "matrix": [[float(f"{v:.6e}") for v in row] for row in self.covariance],
            },
            "spreads": {name: rounded(value) for name, value in self.spreads.items()},
            "untold": list(self.untold),
            "warnings": list(self.warnings),
            "frames": list(self.frames),
            "left_out": [{"frame": name, "reason": reason} for name, reason in self.left_out.items()],
            "leave_one_out": {
                name: {"iou": rounded(iou), "contour_px": rounded(px)} for name, (iou, px) in self.leave_one_out.items()
            },
            "quality": {"iou": rounded(self.iou), "contour_px_95": rounded(self.contour_px_95)},
            "lag": self.lag,
            "arm": self.arm,
            "roll_offset": self.roll_offset,
            "seconds": round(self.seconds, 3),
            "seed": self.seed,
            "version": self.version,
            "config": self.config,
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], *, where: str = "session") -> SessionCalibration:
        """Take a calibration from its document.

        Raises
        ------
        InputError
            A field that is missing or wrong; the message begins with ``where``.
        """
        fields = Fields.of(where, document)
        if fields.count("schema", SCHEMA) != SCHEMA:
            raise fields.refuse("schema", f"{SCHEMA}, the only one known to this version")
        base = fields.pose("camera_from_base", required=True)
        assert base is not None
        offsets = fields.numbers("offsets", required=True)
        axes = (*BASE_AXES, *offsets)
        arm = fields.choice("arm", ("classic", "si"), "classic")
        lone, quality, config = (fields.inner(name) for name in ("leave_one_out", "quality", "config"))
        if quality is None:
            raise fields.refuse("quality", "an object")
        return cls(
            instrument=fields.text("instrument"),
            camera_from_base=base,
            offsets=offsets,
            axes=axes,
            covariance=_covariance(fields, axes),
            spreads=_spreads(fields),
            frames=fields.texts("frames"),
            left_out={one.text("frame"): one.text("reason") for one in fields.inners("left_out")},
            leave_one_out={} if lone is None else _leave_one_out(lone),
            iou=quality.number("iou"),
            contour_px_95=quality.number("contour_px_95"),
            lag=fields.numbers("lag") if fields.has("lag") else None,
            untold=fields.texts("untold"),
            warnings=fields.texts("warnings"),
            arm="si" if arm == "si" else "classic",
            roll_offset=fields.number("roll_offset", 0.0),
            seconds=fields.number("seconds", 0.0),
            seed=fields.count("seed"),
            version=fields.text("version"),
            config={} if config is None else dict(config.values),
        )

    def model(self, outer: Float64, joints: Float64, joint_names: tuple[str, ...]) -> tuple[SessionModel, Calibration]:
        """Return the model of other frames of the session, readings (N, 4) and (N, J), and its calibration.

        Raises
        ------
        InputError
            The session is of an instrument with other joints.
        """
        names = (*OUTER_OFFSETS, *joint_names)
        if tuple(self.offsets) != names:
            raise InputError(
                f"session: offsets: expected those of {', '.join(names)}, got {', '.join(self.offsets) or 'none'}"
            )
        needed = ("yaw", "pitch", "insertion", "roll", *joint_names, "slack_translation", "slack_rotation")
        missing = [name for name in needed if name not in self.spreads]
        if missing:
            raise InputError(f"session: spreads: expected those of {', '.join(needed)}, got no {', '.join(missing)}")
        values = [self.spreads[name] for name in needed]
        slack = np.array([values[-2]] * 3 + [values[-1]] * 3)
        spreads = Spreads(np.array(values[:4]), np.array(values[4:-2]), slack)
        model = SessionModel(outer, joints, joint_names, spreads, arm=self.arm, roll_offset=self.roll_offset)
        return model, Calibration(self.camera_from_base, np.array(list(self.offsets.values())))


def describe_solution(model: SessionModel, solution: Solution, config: EstimateConfig) -> dict[str, Any]:
    """Name the parts of a solution, as fields of a `SessionCalibration`."""
    names = (*OUTER_OFFSETS, *model.names)
    spreads = model.spreads
    std = np.sqrt(np.diag(solution.covariance))
    return {
        "camera_from_base": solution.calibration.camera_from_base,
        "offsets": dict(zip(names, solution.calibration.offsets.tolist(), strict=True)),
        "axes": (*BASE_AXES, *names),
        "covariance": solution.covariance,
        "spreads": {
            **dict(zip(("yaw", "pitch", "insertion", "roll"), spreads.outer.tolist(), strict=True)),
            **dict(zip(model.names, spreads.joints.tolist(), strict=True)),
            "slack_translation": float(spreads.slack[0]),
            "slack_rotation": float(spreads.slack[3]),
        },
        "untold": tuple(_untold(std, names, config)),
        "seed": config.seed,
    }


def _untold(std: Float64, names: tuple[str, ...], config: EstimateConfig) -> list[str]:
    """Say what the session cannot tell: where its standard deviation is as wide as what was expected beforehand."""
    session = config.session
    found = []
    if std[:3].max() > _UNTOLD_SHIFT:
        found.append(f"place of the base: standard deviation {std[:3].max() * 1e3:.1f} mm")
    if std[3:6].max() > _UNTOLD_TURN:
        found.append(
            f"rotation of the base: standard deviation {np.degrees(std[3:6].max()):.1f} deg; the arm hardly turns, and "
            "its rotation cannot be told from the offset of roll"
        )
    expected = [session.insertion_offset_mm * 1e-3, np.deg2rad(session.roll_offset_deg)]
    expected += [float(np.deg2rad(config.readings.of(name))) for name in names[2:]]
    for name, deviation, before in zip(names, std[6:], expected, strict=True):
        if deviation > _UNTOLD * before:
            amount = f"{deviation * 1e3:.2f} mm" if name == "insertion" else f"{np.degrees(deviation):.1f} deg"
            found.append(f"offset of {name}: standard deviation {amount}, as wide as expected beforehand")
    return found


def _covariance(fields: Fields, axes: tuple[str, ...]) -> Float64:
    """Matrix (K, K) of the covariance, whose axes must be the calibration's own."""
    covariance = fields.inner("covariance", required=True)
    assert covariance is not None
    if covariance.texts("axes") != axes:
        raise covariance.refuse("axes", ", ".join(axes))
    matrix = covariance.array("matrix", (len(axes), len(axes)))
    if matrix is None or (np.diag(matrix) < 0).any():
        raise covariance.refuse("matrix", f"{len(axes)} rows of {len(axes)} finite numbers, no negative variance")
    return matrix


def _spreads(fields: Fields) -> dict[str, float]:
    inner = fields.inner("spreads", required=True)
    assert inner is not None
    for name in inner.values:
        if inner.number(name) <= 0:
            raise inner.refuse(name, "a number above 0")
    return fields.numbers("spreads")


def _leave_one_out(fields: Fields) -> dict[str, tuple[float, float]]:
    found = {}
    for name in fields.values:
        one = fields.inner(name, required=True)
        assert one is not None
        found[name] = one.number("iou"), one.number("contour_px")
    return found


def read_calibration(path: str | Path) -> SessionCalibration:
    """Read a session's calibration; InputError names the file and the field."""
    document = read_json_object(Path(path), expected="a session calibration (session.json)")
    return SessionCalibration.from_dict(document, where=str(path))
