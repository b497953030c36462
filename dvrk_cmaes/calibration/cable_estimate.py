"""The cables of a session while it is calibrated: fitted once the frames are settled, and used as a correction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.calibration.cables import CableFit, CableSession, fit_cables, observe_errors
from dvrk_cmaes.calibration.lag_estimate import LagEstimate
from dvrk_cmaes.calibration.lasting_errors import frames_alike
from dvrk_cmaes.calibration.model import Deviations, SessionModel
from dvrk_cmaes.calibration.solve import FrameFits, Solution
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.cable_prior import CablePrior, cable_prior

_ROLL = 3  # index among the outer joints
_ALIKE_SECONDS = 1.0  # over which masks err alike, so that their frames count as one


@dataclass(frozen=True, eq=False)
class CableEstimate:
    """Estimate of the cables of a session.

    ``names`` are the cable-driven joints, ``noise`` (1 + J,), rad, the initial standard deviations of their readings
    from frame to frame and ``offset_std`` (1 + J,), rad, those of the offsets' priors. ``fit`` is the current fit, None
    before the first; ``alone`` is that of models that need nothing but the reading of a frame itself.
    """

    names: tuple[str, ...]
    noise: Float64
    offset_std: Float64
    fit: CableFit | None = None
    alone: CableFit | None = None

    @classmethod
    def of(cls, joint_names: tuple[str, ...], deviations: Deviations, offset_std: Float64) -> CableEstimate:
        """Return what is known before the first fit, of an instrument's joints."""
        noise = np.concatenate([deviations.outer[_ROLL:], deviations.joints])
        return cls(("roll", *joint_names), noise, offset_std)

    @property
    def prior(self) -> CablePrior:
        """What is expected of the cables beforehand."""
        return cable_prior(self.names)

    def deviations(self, usual: Deviations) -> Deviations | None:
        """Return the standard deviations of corrected readings from frame to frame; None if nothing is corrected.

        ``usual`` are those without correction.
        """
        if self.fit is None or not self.fit.parts:
            return None
        outer = np.concatenate([usual.outer[:_ROLL], self.fit.noise[:1]])
        return Deviations(outer, self.fit.noise[1:], usual.slack)

    def corrected(self, model: SessionModel) -> SessionModel:
        """Return the model of the same frames with their corrections."""
        return model if self.fit is None else replace(model, correction=self.fit.correction)

    def estimated(self, model: SessionModel, fits: FrameFits, solution: Solution, lag: LagEstimate) -> CableEstimate:
        """Fit the cables: ``fits`` and ``solution`` are of the frames of the model, ``lag`` has times and readings."""
        times = lag.seconds()
        weights = solution.weights if times is None else solution.weights / frames_alike(times, _ALIKE_SECONDS)
        information, vector = observe_errors(model, fits, solution.calibration, weights)
        readings = np.concatenate([model.outer[:, _ROLL:], model.joints], axis=1)
        play, offsets = lag.play(self.names, readings, self.prior.model.width), solution.calibration.offsets[1:]
        seen = information, vector, offsets, self.offset_std, self.noise
        session = CableSession(self.names, readings, times, play, *seen)
        fit, alone = fit_cables(session, self.prior)
        return replace(self, fit=fit, alone=alone)
