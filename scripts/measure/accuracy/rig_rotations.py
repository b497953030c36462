"""Rotations of the right eye that stereo sessions find against a rig whose file is right or turned.

Each session is estimated with its right rig and with the right eye turned by 0.1 and 0.3 deg about each axis; its
frames together tell the rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.session_rig import rotations_of_session
from dvrk_cmaes.camera.rig import turned_views
from dvrk_cmaes.errors import InputError
from measure.cases import Case, Measurement, Run, grouped

Float64 = NDArray[np.float64]

_ANGLES_DEG: Final = (0.1, 0.3)
_WITHIN: Final = 2.5  # standard deviations


@dataclass(frozen=True)
class _Found:
    """What the frames of a session tell: by how much the eye is turned, and whether the file is contradicted."""

    angle: float
    off_deg: Float64
    std_deg: Float64
    contradicted: bool

    @property
    def largest_sigmas(self) -> float:
        """The largest error about an axis in standard deviations."""
        return float(np.abs(self.off_deg / self.std_deg).max())


def _turns() -> dict[str, Float64]:
    """Return the rotations, deg, by the kind of case."""
    axes = dict(zip("xyz", np.eye(3), strict=True))
    turns = {f"{angle} deg about {axis}": angle * row for angle in _ANGLES_DEG for axis, row in axes.items()}
    return {"right file": np.zeros(3), **turns}


def rotations_report(given: Measurement) -> dict[str, list[dict[str, Any]]]:
    """Estimate the frames of stereo sessions with right and turned rigs, and return how well the turns are found.

    Raises
    ------
    InputError
        A session has one view, or an estimate no pose.
    """
    for one in given.recordings():
        if len(one.session.rig.views) == 1:
            raise InputError(f"{one.session.folder}: expected a stereo session (masks/left, masks/right), got one view")
    cases = [_turned(case, kind, turn) for case in given.cases(every_view=True) for kind, turn in _turns().items()]
    runs = replace(given, keep=None).runs(cases)
    found: dict[float, list[_Found]] = {}
    for of_session in grouped(runs, lambda run: run.case.session).values():
        for kind, own in grouped(of_session, lambda run: run.case.kind).items():
            told = _found(_turns()[kind], own)
            found.setdefault(told.angle, []).append(told)
    return {"rotations of the right eye": [_summary(angle, own) for angle, own in sorted(found.items())]}


def _turned(case: Case, kind: str, turn: Float64) -> Case:
    """Return a frame whose right eye is believed to be turned by -turn, deg, against where it is."""
    data = replace(case.data, views=turned_views(case.data.views, {"right": -np.deg2rad(turn)}))
    return replace(case, kind=kind, data=data)


def _found(turn: Float64, runs: Sequence[Run]) -> _Found:
    """Return what the frames of one session tell about the right eye, which is turned by ``turn``, deg."""
    (rotation,) = rotations_of_session(run.result for run in runs)
    angle = round(float(np.linalg.norm(turn)), 3)
    return _Found(angle, rotation.rotation_deg - turn, rotation.std_deg, rotation.applied)


def _summary(angle: float, found: Sequence[_Found]) -> dict[str, Any]:
    """Return how well rotations by an angle are found, over sessions and axes."""
    sigmas = np.array([one.largest_sigmas for one in found])
    off = np.abs([one.off_deg for one in found])
    return {
        "turned by, deg": angle,
        "sessions": len(found),
        "file contradicted": sum(one.contradicted for one in found),
        f"within {_WITHIN} std": round(float((sigmas <= _WITHIN).mean()), 3),
        "largest, std": round(float(sigmas.max()), 2),
        "error about x, y, z, deg: median": " ".join(f"{value:.3f}" for value in np.median(off, axis=0)),
        "largest": " ".join(f"{value:.3f}" for value in off.max(axis=0)),
        "stated std, deg: median": " ".join(
            f"{value:.3f}" for value in np.median([one.std_deg for one in found], axis=0)
        ),
    }
