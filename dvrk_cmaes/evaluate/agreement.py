"""All measures of agreement of the frames of one set of results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.consistency import (
    BaseSpread,
    Convergence,
    PointSpread,
    base_spread,
    converge_shafts,
    rcm_spread,
)
from dvrk_cmaes.evaluate.result_set import ResultSet
from dvrk_cmaes.instrument.arm import OUTER_JOINTS, ROLL_OFFSET, Arm
from dvrk_cmaes.io.encode import encoded, encoded_fields


@dataclass(frozen=True, eq=False)
class Agreement:
    """Agreement of the frames of a set.

    axes : convergence of the shafts' axes.
    rcm : the frames' RCMs, None unless the insertion of every frame is known.
    base : the frames' poses of the arm's base, None unless all outer joints of every frame are known.
    """

    results: ResultSet
    axes: Convergence
    rcm: PointSpread | None
    base: BaseSpread | None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: m and degrees, positions in the camera's frame."""
        results, rcm, base = self.results, self.rcm, self.base
        document = {
            "results": results.name,
            "solved": results.solved,
            "agree_by_construction": results.by_construction,
            **encoded_fields(results, "alone", "frames", "failed", "doubtful"),
            "converging_point_m": self.axes.point,
            "sigma_m": self.axes.sigma,
            "rms_m": self.axes.rms,
            "turn_deg": float(np.degrees(self.axes.turn)),
            "distances_m": dict(zip(results.frames, self.axes.distances.tolist(), strict=True)),
            "rcm": rcm and {"mean_m": rcm.centre, "spread_m": rcm.rms},
            "base": base
            and {
                "rotation_deg_median": base.median_deg,
                "rotation_deg_max": base.largest_deg,
                "rotation_deg": dict(zip(results.frames, base.angles_deg.tolist(), strict=True)),
            },
        }
        found: dict[str, Any] = encoded(document)
        return found


def measure_agreement(results: ResultSet, *, arm: Arm | None = None, roll_offset: float | None = None) -> Agreement:
    """Compute the measures of agreement for which a set has the readings.

    Parameters
    ----------
    results
        At least three frames.
    arm, roll_offset
        The arm, and the DH parameter d of the tool's roll joint, m; by default those stated in the results, or else
        those of the Classic with a tool 400xxx.

    Raises
    ------
    InputError
        Fewer than three frames or parallel axes; the message names the set.
    """
    arm = arm or results.arm or "classic"
    if roll_offset is None:
        roll_offset = ROLL_OFFSET if results.roll_offset is None else results.roll_offset
    poses = results.camera_from_root
    try:
        axes = converge_shafts(poses)
    except InputError as error:
        raise InputError(f"{results.name}: {error}") from None
    insertion, outer = results.outer("insertion"), results.outer(*OUTER_JOINTS)
    return Agreement(
        results=results,
        axes=axes,
        rcm=None if insertion is None else rcm_spread(poses, insertion[:, 0], arm, roll_offset=roll_offset),
        base=None if outer is None else base_spread(poses, outer, arm, roll_offset=roll_offset),
    )
