"""The readings at the times of images: late by the lag, which is found on the way if it is not given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm, base_from_root
from dvrk_cmaes.joints.cables import CableModel
from dvrk_cmaes.track.cables import CableMemory
from dvrk_cmaes.track.hypothesis import Hypothesis, Located
from dvrk_cmaes.track.lag import LAGS, FoundLag, LagSearch
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.reading_buffer import ReadingBuffer


class LaggedReadings:
    """The latest readings of an arm, the errors that its cables make expect, and the lag of the images behind them.

    ``buffer`` has the readings. ``lag`` s is used if it is given, else that of the ``calibration``, else it is found.
    """

    def __init__(
        self,
        instrument: Instrument,
        arm: Arm,
        config: TrackConfig,
        calibration: SessionCalibration | None,
        lag: float | None,
    ) -> None:
        self.buffer = ReadingBuffer(instrument.joint_names, config.reading_gap, config.still_seconds)
        self._joints = len(instrument.joint_names)
        self._cables = CableMemory.of(calibration)
        self._lags = LagSearch(lambda outer: base_from_root(outer, arm, roll_offset=instrument.roll_offset))
        given_by_hand = lag is not None
        if lag is None and calibration is not None and calibration.lag is not None:
            lag = calibration.lag.seconds
        self._given = lag is not None
        self._unknown_std = config.lag_std
        self._by_hand = given_by_hand
        self.lag = FoundLag(0.0, config.lag_std) if lag is None else FoundLag(float(lag), 0.0)

    @property
    def cables(self) -> CableModel | None:
        """Model of the cables; None without one."""
        return None if self._cables is None else self._cables.model

    @property
    def known_lag(self) -> FoundLag | None:
        """Lag of the images behind the readings; None while it is not determined."""
        return self.lag if self._given or self.lag.std < self._unknown_std else None

    def anchor(self, time: float, before: Anchor | None) -> Anchor:
        """Return the readings at the time of an image less the lag, based on those of the image before."""
        reading = self.buffer.at(time - self.lag.seconds)
        expected = None if self._cables is None else self._cables.expected(reading)
        last = Anchor.none(self._joints) if before is None else before
        return last.then(reading, moving=not reading.still, expected=expected)

    def learn_lag(self, time: float, one: Hypothesis, located: Located) -> None:
        """Add a pose, which is ``located``, to those from which the lag is found."""
        if self._given or not one.anchor.outer_read:
            return
        self._lags.add(located.at.pose, located.covariance, self.buffer.outer_at(time - LAGS))
        if self._lags.due:
            self.lag = self._lags.search(one.state.camera_from_base) or self.lag

    def forget_lag(self) -> None:
        """Find the lag anew, if it was that of the calibration."""
        if self._given and not self._by_hand:
            self._given, self.lag = False, FoundLag(0.0, self._unknown_std)

    def forget_poses(self) -> None:
        """Forget the poses from which the lag is found: those that follow are of another base or mode."""
        self._lags.clear()

    def checkpoint(self) -> dict[str, Any]:
        """Return all but the readings as plain values."""
        return {
            "lag": [self.lag.seconds, self.lag.std],
            "lags": self._lags.checkpoint(),
            "cables": None if self._cables is None else self._cables.checkpoint(),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from the values of `checkpoint`; KeyError, TypeError or ValueError if they are not those."""
        self.lag = FoundLag(*(float(value) for value in saved["lag"]))
        self._lags.restore(saved["lags"])
        if self._cables is not None:
            self._cables.restore(saved["cables"])
