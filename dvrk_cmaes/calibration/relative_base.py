"""Where the bases of a session's arms are relative to each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.geometry import adjoint, inverse, log_rotation
from dvrk_cmaes.io.encode import SIGNIFICANT, encoded_fields
from dvrk_cmaes.joints.names import ECM_JOINTS

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RelativeBase:
    """Pose of an arm's base in the base of a reference arm.

    ``reference_from_base`` is (4, 4), m; ``covariance`` (6, 6) that of its small changes [t, r] in the arm's own base's
    axes, m and rad.
    """

    reference_from_base: Float64 = field(metadata=SIGNIFICANT)
    covariance: Float64 = field(metadata=SIGNIFICANT)

    @classmethod
    def between(cls, reference: SessionCalibration, other: SessionCalibration) -> RelativeBase:
        """Compute the pose of an arm's base in a reference arm's from the calibrations of both with one camera.

        The errors of both bases are taken for independent. Those that an error of the camera file causes have the same
        direction in both, so that the true covariance is rather smaller.
        """
        reference_from_base = inverse(reference.camera_from_base) @ other.camera_from_base
        of_reference = adjoint(inverse(reference_from_base))
        covariance = other.covariance[:6, :6] + of_reference @ reference.covariance[:6, :6] @ of_reference.T
        return cls(np.asarray(reference_from_base), np.asarray(covariance))

    def to_dict(self) -> dict[str, Any]:
        """Return the values in the documented schema, ready for JSON."""
        return encoded_fields(self, "reference_from_base", "covariance")

    def describe(self) -> str:
        """Describe distance and angle in words, with standard deviations."""
        away, std = self.reference_from_base[:3, 3], np.sqrt(np.diag(self.covariance))
        angle = np.linalg.norm(log_rotation(self.reference_from_base[:3, :3]))
        return (
            f"{1e3 * np.linalg.norm(away):.1f} mm away, turned by {np.degrees(angle):.2f} deg (std per axis "
            f"{1e3 * std[:3].mean():.1f} mm, {np.degrees(std[3:].mean()):.2f} deg)"
        )


def relative_bases(calibrations: Mapping[str, SessionCalibration]) -> dict[str, RelativeBase]:
    """Return the bases of all arms but the first, by name, in the base of the first.

    Where the endoscope moved, they are compared at one of its places; an arm whose base is not known there is left out.
    """
    reference, *others = calibrations
    moves = calibrations[reference].endoscope
    where: dict[str, Any] = {}
    if moves is not None and moves.bases:
        stand = next((one for one in moves.bases if one.place == 0), moves.bases[0])
        where = {"frame": stand.first, "time": stand.start}
    readings = {} if moves is None or not moves.places else dict(zip(ECM_JOINTS, moves.places[0].readings, strict=True))
    placed = {arm: own.at(readings, **where) for arm, own in calibrations.items()}
    still = {arm: own for arm, own in placed.items() if isinstance(own, SessionCalibration)}
    return {arm: RelativeBase.between(still[reference], still[arm]) for arm in others if {reference, arm} <= set(still)}
