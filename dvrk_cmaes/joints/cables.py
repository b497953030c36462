"""Errors of cable-driven joints as functions of their readings: offset, coupling, play and wander.

For C joints with readings r, in the order of time,

    true - reading = offset + coupling (r - reference) + play wide(r) + narrow * narrow(r) + wander + noise

``wide`` and ``narrow`` are how far the joints stay behind their readings (`joints.play`). The diagonal of ``play`` is a
joint's own; the rest is the drag of the other joints' cables, which run over the same pulleys. The wander is an
Ornstein-Uhlenbeck process.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.play import Play

PARAMETERS = ("reference", "coupling", "play", "narrow", "width", "wander", "seconds", "noise")
"""Fields of a `CableModel` but the names and the offset."""


@dataclass(frozen=True, eq=False)
class CableModel:
    """Parameters of the errors of C cable-driven joints; rad and seconds.

    names : of the joints. reference : (C,) readings at which coupling adds nothing. offset : (C,).
    coupling : (C, C), error of the joint of the row for each rad of the reading of the column.
    play : (C, C), error for each rad that the column's joint stays behind in the wide band; narrow : (C,), for each rad
    that the joint itself does in the narrow band. width : (C,) half width of the wide band.
    wander, seconds : (C,) standard deviation and correlation time of the wander. noise : (C,) standard deviation.
    """

    names: tuple[str, ...]
    reference: Float64
    offset: Float64
    coupling: Float64
    play: Float64
    narrow: Float64
    width: Float64
    wander: Float64
    seconds: Float64
    noise: Float64

    @property
    def coefficients(self) -> Float64:
        """Coefficients (C, 2 C + 1) of each joint's `features`."""
        return np.concatenate([self.coupling, self.play, self.narrow[:, None]], axis=1)

    def errors(self, readings: Float64, play: Play) -> Float64:
        """Return true - reading (N, C), without wander and noise, of readings (N, C) and the play there."""
        terms = features(readings, play, self.reference)
        return np.asarray(self.offset + np.einsum("ncf,cf->nc", terms, self.coefficients))


def features(readings: Float64, play: Play, reference: Float64) -> Float64:
    """Return what the coefficients of each joint multiply, (N, C, 2 C + 1).

    These are the readings (N, C) less ``reference`` (C,), how far all joints stay behind in the wide band, and the
    joint itself in the narrow band; zero where there is no reading.
    """
    count = readings.shape[1]
    shared = np.concatenate([np.nan_to_num(readings - reference), play.wide], axis=1)
    return np.concatenate([np.repeat(shared[:, None], count, axis=1), play.narrow[:, :, None]], axis=2)
