"""Smoothing of a followed recording: the filter's states corrected by all later images (Rauch, Tung and Striebel)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.results.tracked import TrackResult
from dvrk_cmaes.track.describe import described
from dvrk_cmaes.track.hypothesis import Follower, Hypothesis
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.state import FilterState

Float64 = NDArray[np.float64]

_REGULAR = 1e-9  # of each variance, that makes a covariance with parts that are exactly known invertible


@dataclass(frozen=True, eq=False)
class FilterStep:
    """What the filter did at one image.

    ``prior`` is the predicted state and ``transition`` (D, D) the derivative of its error by that of the state before;
    both None where the filter started, or started again. ``posterior`` is the corrected state, or the predicted one if
    the image did not correct it. ``anchor`` has the readings.
    """

    prior: FilterState | None
    transition: Float64 | None
    posterior: FilterState
    anchor: Anchor


def smoothed_states(steps: Sequence[FilterStep]) -> list[FilterState]:
    """Return the states of all images given all images; each start begins a part that is smoothed by itself."""
    smoothed: list[FilterState] = []
    for step, later in zip(reversed(steps), [None, *reversed(steps[1:])], strict=True):
        if later is None or later.prior is None or later.transition is None:
            smoothed.append(step.posterior)
            continue
        before, after = step.posterior, smoothed[-1]
        predicted = later.prior.covariance
        scale = np.sqrt(np.diag(predicted)) + 1e-12
        scaled = predicted / np.outer(scale, scale) + _REGULAR * np.eye(len(scale))
        gain = (np.linalg.solve(scaled, (later.transition @ before.covariance) / scale[:, None]) / scale[:, None]).T
        covariance = before.covariance + gain @ (after.covariance - predicted) @ gain.T
        changed = before.changed(gain @ later.prior.difference(after))
        smoothed.append(replace(changed, covariance=(covariance + covariance.T) / 2))
    return smoothed[::-1]


class Recorder:
    """The filter's steps and results of all images, to be smoothed."""

    def __init__(self) -> None:
        self._steps: list[tuple[FilterStep | None, TrackResult]] = []

    def add(self, step: FilterStep | None, best: Hypothesis | None, result: TrackResult) -> None:
        """Add an image: its step, None where the filter started anew; the hypothesis then; and its result."""
        if best is None:
            self._steps.append((None, result))
            return
        begun = FilterStep(None, None, best.state, best.anchor) if step is None else step
        self._steps.append((replace(begun, posterior=best.state), result))

    def smoothed(self, follower: Follower) -> list[TrackResult]:
        """Return the results of all images given all images; status and reasons stay as they were."""
        states = iter(smoothed_states([step for step, _ in self._steps if step is not None]))
        return [
            result if step is None else described(follower, Hypothesis(next(states), step.anchor, 1.0), result)
            for step, result in self._steps
        ]
