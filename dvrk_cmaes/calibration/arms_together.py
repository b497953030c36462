"""The endoscope of a session of several arms, by what all of them tell of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Steered, SteeredValues
from dvrk_cmaes.calibration.relative_base import RelativeBase
from dvrk_cmaes.geometry import adjoint, inverse, moved
from dvrk_cmaes.io.rounding import rounded, rounded_array
from dvrk_cmaes.joints.names import ECM_JOINTS

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ArmsTogether:
    """What several arms tell together: the endoscope's values, each arm's base at the reference place, and errors.

    ``covariance`` (6 A + M, 6 A + M) is of the bases of A arms, along and about their own axes, and of the M values.
    """

    arms: tuple[str, ...]
    bases: tuple[Float64, ...]
    endoscope: Steered
    values: SteeredValues
    covariance: Float64

    @classmethod
    def of(cls, calibrations: Mapping[str, SessionCalibration]) -> ArmsTogether | None:
        """Put the calibrations of several arms together, each of which has the endoscope's prior.

        None of an endoscope that stood still or is not read, or if the arms' places are others. What is known of the
        endoscope beforehand counts once. The errors of the camera's file and of the lag are not shared.
        """
        found = [_steered(one) for one in calibrations.values()]
        parts = [one for one in found if one is not None]
        if len(parts) < len(calibrations) or len(parts) < 2:
            return None
        (first, start), others = parts[0], parts[1:]
        if any(not _same_places(first, steered) for steered, _ in others):
            return None
        shared, count = len(start.deviation), len(parts)
        size = 6 * count + shared
        prior = np.diag(start.std**-2.0)
        information, vector = np.zeros((size, size)), np.zeros(size)
        place = np.arange(6 * count, size)
        for number, (calibration, (_, values)) in enumerate(zip(calibrations.values(), parts, strict=True)):
            own = len(calibration.axes)
            kept = np.r_[np.arange(6), np.arange(own, own + shared)]
            at = np.r_[np.arange(6 * number, 6 * number + 6), place]
            told = np.linalg.inv(calibration.whole_covariance[np.ix_(kept, kept)])
            away = np.concatenate([np.zeros(6), values.deviation - start.deviation])
            information[np.ix_(at, at)] += told
            vector[at] += told @ away
        more = count - 1  # times that the prior is counted too much
        reduced = information.copy()
        reduced[np.ix_(place, place)] -= more * prior
        if np.linalg.eigvalsh(reduced).min() <= 0:  # stated deviations are wider than those beforehand
            more, reduced = 0, information
        vector[place] += more * prior @ start.deviation
        covariance = np.linalg.inv(reduced)
        step = covariance @ vector
        bases = tuple(
            moved(calibration.camera_from_base, step[6 * number : 6 * number + 6])
            for number, calibration in enumerate(calibrations.values())
        )
        return cls(tuple(calibrations), bases, first, start.changed(step[6 * count :]), np.asarray(covariance))

    def relative(self) -> dict[str, RelativeBase]:
        """Return the bases of all arms but the first, by name, in the base of the first."""
        found = {}
        for number, name in enumerate(self.arms[1:], start=1):
            reference_from_base = inverse(self.bases[0]) @ self.bases[number]
            jacobian = np.zeros((6, len(self.covariance)))
            jacobian[:, 6 * number : 6 * number + 6] = np.eye(6)
            jacobian[:, :6] = -adjoint(inverse(reference_from_base))
            found[name] = RelativeBase(reference_from_base, jacobian @ self.covariance @ jacobian.T)
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the endoscope as plain values for JSON, with the bases in that of its arm by name."""
        values, size = self.values, 6 * len(self.arms)
        std = np.sqrt(np.diag(self.covariance))
        of_offsets = dict(zip(ECM_JOINTS, std[size + 6 : size + 10].tolist(), strict=True))
        arms = {}
        for number, (name, base) in enumerate(zip(self.arms, self.bases, strict=True)):
            jacobian = np.zeros((6, len(self.covariance)))
            jacobian[:, 6 * number : 6 * number + 6] = np.eye(6)
            ecm_from_base, jacobian[:, size : size + 10] = self.endoscope.ecm_from_base(values, base)
            arms[name] = {
                "ecm_from_base": rounded_array(ecm_from_base),
                "std": rounded_array(np.sqrt(np.diag(jacobian @ self.covariance @ jacobian.T))),
            }
        return {
            "tip_from_camera": rounded_array(values.tip_from_camera),
            "std_tip_from_camera": rounded_array(std[size : size + 6]),
            "offsets": {name: rounded(one) for name, one in zip(ECM_JOINTS, values.offsets.tolist(), strict=True)},
            "std_offsets": {name: rounded(one) for name, one in of_offsets.items()},
            "arms": arms,
        }


def _steered(calibration: SessionCalibration) -> tuple[Steered, SteeredValues] | None:
    """Return the endoscope of a calibration at its reference place, and its values; None where it is not read."""
    own = calibration.endoscope
    if own is None or not own.places:
        return None
    found = own.in_frames(calibration.camera_from_base, np.array([own.places[0].readings]), [None], [""])
    if isinstance(found, str) or not isinstance(found[0], Steered) or not isinstance(found[1], SteeredValues):
        return None
    return found[0], found[1]


def _same_places(one: Steered, other: Steered) -> bool:
    """Whether two arms saw the endoscope at the same places."""
    if len(one.places) != len(other.places):
        return False
    pairs = zip(one.places, other.places, strict=True)
    return all((np.abs(a.readings - b.readings) <= np.maximum(a.within, b.within)).all() for a, b in pairs)
