"""One ``camera_from_base`` for the exports that want one, chosen by a stated rule.

1. Of a session calibration, its own.
2. Of one frame (a result by itself, or a frame that was asked for), that frame's.
3. Of a folder of results, the frames' median: of those marked ok that have one, if they are at least three; of fewer,
   the doubtful ones count as well, which is said. Failed frames never count.

A frame's own comes from its readings of the outer joints as they are, with their offsets; a session's is without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import rotation_angle, transform
from dvrk_cmaes.io.fields import Fields
from dvrk_cmaes.results.result import Result

Float64 = NDArray[np.float64]

_WIDE_MM, _WIDE_DEG = 5.0, 5.0  # a median spread beyond which somebody should look
_ENOUGH = 3  # ok frames that make a median by themselves
_STEPS = 200  # of the medians; they settle long before
_NEAR = 1e-9  # m and rad: keeps weights finite


@dataclass(frozen=True, eq=False)
class ChosenBase:
    """The choice: ``camera_from_base`` (4, 4), in words where it comes from, and what to beware of.

    ``frames`` are those used; ``spread_mm`` and ``spread_deg`` the median distance of theirs from the choice, of the
    base's origin (the RCM) and of its rotation, None where there was nothing to choose from.
    """

    camera_from_base: Float64
    origin: str
    frames: tuple[str, ...]
    spread_mm: float | None = None
    spread_deg: float | None = None
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "camera_from_base": np.round(self.camera_from_base, 9).tolist(),
            "origin": self.origin,
            "frames": list(self.frames),
            "spread_mm": self.spread_mm,
            "spread_deg": self.spread_deg,
            "warnings": list(self.warnings),
        }


def base_of_session(where: str, document: Mapping[str, Any]) -> ChosenBase:
    """Take a session calibration's; ``where`` names its file in errors (`InputError`)."""
    fields = Fields(where, document)
    camera_from_base = fields.pose("camera_from_base", required=True)
    assert camera_from_base is not None
    frames = fields.texts("frames")
    return ChosenBase(camera_from_base, f"the session calibration {where} of {len(frames)} frames", frames)


def base_of_frame(where: str, result: Result) -> ChosenBase:
    """Take one frame's.

    Raises
    ------
    InputError
        It has none.
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
    """Take the median of several frames; one frame's if only one has any.

    Raises
    ------
    InputError
        None of the frames that did not fail has one.
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
    """Geometric medians of translations and of rotations, (N, 4, 4) to (4, 4).

    The point, and the rotation, whose distances (angles) to the others have the least sum, by Weiszfeld's iteration:
    up to half of the poses may be anything.
    """
    rotations, points = Rotation.from_matrix(poses[:, :3, :3]), poses[:, :3, 3]
    point, rotation = np.median(points, axis=0), rotations.mean()
    for _ in range(_STEPS):
        near = 1 / np.maximum(np.linalg.norm(points - point, axis=1), _NEAR)
        point = near @ points / near.sum()
        angles = (rotation.inv() * rotations).magnitude()
        rotation = rotations.mean(weights=1 / np.maximum(angles, _NEAR))
    return transform(rotation.as_matrix(), point)
