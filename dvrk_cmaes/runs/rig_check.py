"""Rigs that are calibrated wrongly, told from all frames of a session together.

A frame states by which rotation each further view would fit the first one better. The errors of the masks differ from
frame to frame, while a wrong calibration turns the view in all of them alike.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.session_rig import FEWEST, pooled_rotation
from dvrk_cmaes.config import TrustConfig
from dvrk_cmaes.results.result import Result

Float64 = NDArray[np.float64]


def rig_doubts(results: Iterable[Result], trust: TrustConfig | None = None) -> list[str]:
    """Say which views of a session contradict the first one, given the results of its frames; empty without any.

    The limits are those of a frame, ``largest_view_deg`` and ``largest_view_sigmas`` of ``trust``.
    """
    limits = TrustConfig() if trust is None else trust
    rotations_of: dict[str, list[tuple[Float64, Float64]]] = {}
    for result in results:
        for check in result.view_fits[1:]:
            pair = np.asarray(check.rotation_deg), np.asarray(check.covariance_deg2)
            rotations_of.setdefault(check.name, []).append(pair)
    doubts = []
    for name, rotations in rotations_of.items():
        if len(rotations) < FEWEST:
            continue
        rotation, covariance = pooled_rotation(rotations)
        angle = float(np.linalg.norm(rotation))
        sigmas = float(np.sqrt(rotation @ np.linalg.solve(covariance, rotation)))
        if angle >= limits.largest_view_deg and sigmas >= limits.largest_view_sigmas:
            doubts.append(
                f"views disagree in {len(rotations)} frames together: {name} fits the first view only if turned by "
                f"{angle:.2f} deg ({sigmas:.0f} standard deviations); the rig seems to be calibrated wrongly"
            )
    return doubts
