"""How far readings that are sparse may be off between two of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from dvrk_cmaes.geometry import Float64

_LEAST_SPACING: Final = 0.03  # s, from which on readings may be too sparse; errors of single ones would count otherwise
_LEVER: Final = 0.01  # m, of the jaws about the shaft's axis
MOST_OFF: Final = 4e-3  # m, by which readings may be off without doubt: what they are off widens the predictions
_INSERTION, _ROLL = 2, 3  # places among the outer joints
_LARGEST_ERROR: Final = 1.0  # rad or m: readings of almost the same time tell any number, whose square spoils digits
LEAST_ERROR: Final = 2e-4
"""Error of an interpolated reading, rad or m, from which on it counts beside the errors of readings themselves."""


@dataclass(frozen=True, eq=False)
class Sparseness:
    """How far the outer joints (4,), rad and m, and the jaws, m, may be off at a time; the spacing, in words."""

    error: Float64
    off: float = 0.0
    between: str = ""

    @staticmethod
    def none() -> Sparseness:
        """Return that of readings of which nothing is known."""
        return Sparseness(np.zeros(4))

    @classmethod
    def of(cls, stamps: Float64, values: Float64, time: float) -> Sparseness:
        """Compute how far a straight line between the readings before and after a time, s, may be off.

        It follows from how much the rates change there. Beyond the last reading, the rate before it is gone on with.

        Parameters
        ----------
        stamps : (N,)
            Times of the readings, s, increasing.
        values : (N, 4)
            Readings of the outer joints: yaw, pitch, insertion, roll; rad and m.
        time
            The time, s.
        """
        after = int(np.clip(np.searchsorted(stamps, time), 1, max(len(stamps) - 1, 1)))
        first, last = max(after - 2, 0), min(after + 2, len(stamps))
        if last - first < 3:
            return cls.none()
        spacing = float(stamps[after] - stamps[after - 1])
        if spacing < _LEAST_SPACING:
            return cls.none()
        steps, seconds = np.diff(values[first:last], axis=0), np.diff(stamps[first:last])
        rates = steps / seconds[:, None]
        between = (seconds[1:] + seconds[:-1])[:, None] / 2
        bent = np.abs(np.diff(rates, axis=0) / between).max(axis=0)
        inside, beyond = (time - stamps[after - 1]) * (stamps[after] - time), max(time - stamps[after], 0.0)
        error = np.minimum(bent * (max(inside, 0.0) / 2 + beyond * (beyond + 3 * spacing) / 2), _LARGEST_ERROR)
        depth = abs(float(values[after, _INSERTION]))
        off = float(np.hypot(*error[:2])) * depth + float(error[_INSERTION]) + _LEVER * float(error[_ROLL])
        change = np.abs(steps).max(axis=0)
        turn = float(np.delete(change, _INSERTION).max())
        moves = (
            f"the insertion changes by {1e3 * change[_INSERTION]:.0f} mm"
            if error[_INSERTION] > off / 2
            else f"the arm turns {np.degrees(turn):.0f} deg"
        )
        return cls(error, off, f"every {1e3 * spacing:.0f} ms, {moves} between them")
