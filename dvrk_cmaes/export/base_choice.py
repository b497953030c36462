"""Choice of the ``camera_from_base`` to export.

1. From a session calibration: its ``camera_from_base``.
2. From one frame (a single result, or a frame selected by name): that frame's ``camera_from_base``.
3. From a folder of results: the median over the frames with status ok that have one, if there are at least three;
   otherwise the median over the ok and the doubtful frames, with a warning. Failed frames are not used.

The ``camera_from_base`` of a frame is computed from the uncorrected readings of the outer joints; that of a session
calibration is corrected for their offsets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec import Struct

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, rotation_angle, transform
from dvrk_cmaes.io.encode import encoded_fields
from dvrk_cmaes.io.short_text import natural
from dvrk_cmaes.io.typed_document import Texts, Transform, convert_document
from dvrk_cmaes.results.result import Result

_WIDE_MM, _WIDE_DEG = 5.0, 5.0  # median distances beyond which a warning is given
_ENOUGH = 3  # least number of ok frames for a median without doubtful ones
_ITERATIONS = 200  # more than are needed for convergence
_NEAR = 1e-9  # m and rad; least distance in a weight, so that weights are finite


class _Stand(Struct):
    first: str
    last: str
    camera_from_base: Transform


class _Endoscope(Struct):
    bases: tuple[_Stand, ...] = ()
    tip_from_camera: Transform | None = None
    ecm_from_base: Transform | None = None


class _ArmOfEndoscope(Struct):
    ecm_from_base: Transform


class _EndoscopeOfArms(Struct):
    arms: dict[str, _ArmOfEndoscope]


class _BasesOfArms(Struct):
    endoscope: _EndoscopeOfArms | None = None


class _SessionBase(Struct):
    camera_from_base: Transform
    frames: Texts | None = None
    endoscope: _Endoscope | None = None


@dataclass(frozen=True, eq=False)
class ChosenBase:
    """The chosen ``camera_from_base``.

    Parameters
    ----------
    camera_from_base : (4, 4)
        The pose of the arm's base in the camera.
    origin
        Description of its source.
    frames
        The frames used.
    spread_mm, spread_deg
        Median distance between the frames' poses and the chosen one, of the base's origin (the RCM), mm, and of the
        rotation, degrees; None unless it is a median.
    warnings
        Warnings about its reliability.
    tip_from_camera, ecm_from_base : (4, 4)
        The camera in the endoscope's tip, and the arm's base in that of the endoscope's arm; None where not known.
    others
        The bases (4, 4) of the session's other arms in that of the endoscope's arm, by name.
    stands
        First and last frame, and ``camera_from_base``, of each time that the endoscope stood.
    """

    camera_from_base: Float64
    origin: str
    frames: tuple[str, ...]
    spread_mm: float | None = None
    spread_deg: float | None = None
    warnings: tuple[str, ...] = ()
    tip_from_camera: Float64 | None = None
    ecm_from_base: Float64 | None = None
    others: Mapping[str, Float64] = field(default_factory=dict)
    stands: Sequence[tuple[str, str, Float64]] = ()

    def in_frame(self, result: Result) -> Float64:
        """Return ``camera_from_base`` (4, 4) in a frame; its own one where the endoscope was moving."""
        for first, last, base in self.stands:
            if natural(first) <= natural(result.frame) <= natural(last):
                return base
        own = result.camera_from_base
        return self.camera_from_base if own is None or not self.stands else own

    def to_dict(self) -> dict[str, Any]:
        """Return the choice as plain values for JSON."""
        return encoded_fields(self, "camera_from_base", "origin", "frames", "spread_mm", "spread_deg", "warnings")


def base_of_session(where: str, document: Mapping[str, Any], others: Mapping[str, Float64]) -> ChosenBase:
    """Take the ``camera_from_base`` of a session calibration; InputError, which begins with ``where``, without one.

    ``others`` are those of the session's other arms, as in `ChosenBase`.
    """
    session = convert_document(where, document, _SessionBase)
    frames = session.frames or ()
    origin, moves = f"the session calibration {where} of {len(frames)} frames", session.endoscope or _Endoscope()
    warnings: tuple[str, ...] = ()
    if session.endoscope is not None and moves.ecm_from_base is None:
        warnings = ("the base moved during the session: this one is that of a part of it (endoscope.bases)",)
    return ChosenBase(
        session.camera_from_base,
        origin,
        frames,
        warnings=warnings,
        tip_from_camera=moves.tip_from_camera,
        ecm_from_base=moves.ecm_from_base,
        others=others,
        stands=[(one.first, one.last, one.camera_from_base) for one in moves.bases],
    )


def bases_of_arms(where: str, document: Mapping[str, Any]) -> dict[str, Float64]:
    """Take the bases of all arms in that of the endoscope's arm, by name, of ``arms.json``; none where not known."""
    moves = convert_document(where, document, _BasesOfArms).endoscope
    return {} if moves is None else {name: own.ecm_from_base for name, own in moves.arms.items()}


def base_of_frame(where: str, result: Result) -> ChosenBase:
    """Take the ``camera_from_base`` of one frame.

    Raises
    ------
    InputError
        The frame has none; the message begins with ``where``.
    """
    if result.camera_from_base is None:
        raise InputError(
            f"{where}: camera_from_base: expected 4 rows of 4 numbers, got none: frame {result.frame} "
            + ("failed" if result.status == "failed" else "was estimated without yaw, pitch, insertion and roll")
        )
    warnings = (f"frame {result.frame} is doubtful: {'; '.join(result.reasons)}",) * (result.status == "doubtful")
    return ChosenBase(
        result.camera_from_base,
        f"frame {result.frame} alone, from its readings of the outer joints as they are",
        (result.frame,),
        warnings=warnings,
    )


def base_of_frames(where: str, results: Sequence[Result]) -> ChosenBase:
    """Take the median ``camera_from_base`` of several frames, or that of the only frame that has one.

    Raises
    ------
    InputError
        No frame has one, or only failed frames; the message begins with ``where``.
    """
    usable = [result for result in results if result.camera_from_base is not None and result.status != "failed"]
    chosen = [result for result in usable if result.status == "ok"]
    warnings: list[str] = []
    if len(chosen) < _ENOUGH and len(chosen) < len(usable):
        warnings.append(f"too few frames are ok ({len(chosen)} of {len(results)}): doubtful ones are used as well")
        chosen = usable
    if not chosen:
        raise InputError(
            f"{where}: camera_from_base: expected a session calibration (session.json), or frames that were estimated "
            f"with yaw, pitch, insertion and roll; got {len(results)} frames without"
        )
    if len(chosen) == 1:
        return base_of_frame(where, chosen[0])
    poses = np.array([result.camera_from_base for result in chosen])
    middle = median_pose(poses)
    spread_mm = float(1e3 * np.median(np.linalg.norm(poses[:, :3, 3] - middle[:3, 3], axis=1)))
    spread_deg = float(np.degrees(np.median(rotation_angle(poses, middle))))
    if spread_mm > _WIDE_MM or spread_deg > _WIDE_DEG:
        warnings.append("the frames disagree: calibrate the session, which takes the outer joints' offsets out")
    return ChosenBase(
        middle,
        f"the median of {len(chosen)} of {len(results)} frames, from their readings of the outer "
        f"joints as they are; half of them lie within {spread_mm:.1f} mm and {spread_deg:.1f} deg of it",
        tuple(result.frame for result in chosen),
        round(spread_mm, 6),
        round(spread_deg, 6),
        tuple(warnings),
    )


def median_pose(poses: Float64) -> Float64:
    """Compute the geometric medians of the translations and of the rotations of poses, (N, 4, 4) to (4, 4).

    The geometric median minimises the sum of distances (rotations: angles) to all poses; it is found by Weiszfeld's
    iteration. It is robust to outliers as long as they are fewer than half of the poses.
    """
    from scipy.spatial.transform import Rotation  # imported late: most exports do without

    rotations, points = Rotation.from_matrix(poses[:, :3, :3]), poses[:, :3, 3]
    point, rotation = np.median(points, axis=0), rotations.mean()
    for _ in range(_ITERATIONS):
        near = 1 / np.maximum(np.linalg.norm(points - point, axis=1), _NEAR)
        point = near @ points / near.sum()
        angles = (rotation.inv() * rotations).magnitude()
        rotation = rotations.mean(weights=1 / np.maximum(angles, _NEAR))
    return transform(rotation.as_matrix(), point)
