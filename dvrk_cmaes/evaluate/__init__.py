"""Evaluation of results: errors against golden poses, and agreement of a session's frames with each other."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tolerance:
    """Largest errors of a pose that counts as right.

    Parameters
    ----------
    root_mm
        Largest distance of the root's origin, mm.
    tip_mm
        Largest distance of the jaw tips (mean of both), mm.
    shaft_deg
        Largest angle between the directions of the shaft (the root's z axis), degrees.
    roll_deg
        Largest rotation about the shaft, degrees.
    pitch_yaw_deg
        Largest difference of every joint except the jaw, degrees.
    jaw_deg
        Largest difference of the jaw, degrees.
    """

    root_mm: float = 0.5
    tip_mm: float = 0.5
    shaft_deg: float = 1.5
    roll_deg: float = 3.0
    pitch_yaw_deg: float = 3.0
    jaw_deg: float = 3.0
