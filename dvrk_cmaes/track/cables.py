"""Errors of readings that the cables of a calibrated arm make expect, while readings come in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.joints.cables import CableModel
from dvrk_cmaes.joints.play import Play, PlayState
from dvrk_cmaes.track.reading_buffer import ReadingAt

Float64 = NDArray[np.float64]

_ROLL = 3  # index among the outer joints


class CableMemory:
    """Follows the readings of roll and of the instrument's joints through their play.

    ``model`` is that of the cables.
    """

    def __init__(self, model: CableModel) -> None:
        self.model = model
        self._state = PlayState.unknown(len(model.names))

    @classmethod
    def of(cls, calibration: SessionCalibration | None) -> CableMemory | None:
        """Return the memory of a calibrated arm; None without a calibration that tells of the cables."""
        if calibration is None or calibration.cables is None:
            return None
        return cls(calibration.cables.model(np.array(list(calibration.offsets.values()))[1:]))

    def expected(self, reading: ReadingAt) -> Float64:
        """Return the errors (C,), rad, that are expected of later readings."""
        readings = np.concatenate([reading.outer[_ROLL:], reading.joints])
        self._state = self._state.after(readings, self.model.width)
        play = self._state.play(readings)
        return np.asarray(self.model.errors(readings[None], Play(play.wide[None], play.narrow[None]))[0])

    def checkpoint(self) -> dict[str, Any]:
        """Return the joints' places within their play as plain values; None for a joint that was not read."""
        places = {"wide": self._state.wide, "narrow": self._state.narrow}
        return {name: [None if np.isnan(v) else v for v in values.tolist()] for name, values in places.items()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        self._state = PlayState(*(np.array(saved[name], dtype=np.float64) for name in ("wide", "narrow")))
        if len(self._state.wide) != len(self.model.names) or len(self._state.narrow) != len(self.model.names):
            raise ValueError("expected a place of each joint")
