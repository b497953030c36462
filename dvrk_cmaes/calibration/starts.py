"""The poses from which a frame is fitted in each round: few where it agrees with the session, else many.

A fit costs a few silhouettes from a start near its minimum, and a hundred from all starts that a frame may need.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.calibration.consensus import INLIER_MISFIT, Mode
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.geometry import Posed, moved
from dvrk_cmaes.pose.terms.expected import Expected

_SETTLED = 0.5  # standard deviations per parameter; a frame whose fit would move by less is not fitted again,
_SETTLED_LAST = 0.15  # and in the last round by this
_NEAR = 3.0  # standard deviations per parameter; a fit that would move by less starts from where it would move to


def first_starts(
    modes: Sequence[Mode], chosen: Mode, misfit: float, expected: Expected, turn: float
) -> tuple[Posed, ...]:
    """Return the starts of a frame's first fit.

    A frame that agrees with the session starts from its ``chosen`` mode, any other from all of its ``modes``, from what
    the session expects, and from that rotated about the shaft by ``turn``, rad, to both sides. ``misfit`` is the
    squared Mahalanobis distance of the chosen mode from what is expected, divided by the number of parameters.
    """
    if misfit < INLIER_MISFIT:
        return (chosen.at,)
    return (*(mode.at for mode in modes), *_around(expected, turn))


def next_starts(
    fit: FrameFit, misfit: float, expected: Expected, turn: float | None, *, last: bool, changed: Posed | None = None
) -> tuple[Posed, ...]:
    """Return the starts of a frame that was fitted before; none if the fit is settled.

    A fit that agrees with the session starts from where it would move to, if that is near. Any other starts from where
    it is and from what the session expects, and from that rotated about the shaft by ``turn``, rad, to both sides, if
    given. ``misfit`` is as in `first_starts`, of the outline that was fitted. ``last`` tells whether the fit will be
    the result. ``changed`` is where the fit moves to with another camera, if it has changed.
    """
    clear = misfit < INLIER_MISFIT
    if changed is not None:
        return (changed,) if clear else (changed, *_around(expected, turn))
    step = fit.step_to(expected)
    if step < (_SETTLED_LAST if last else _SETTLED) and (clear or turn is None):
        return ()
    if step < _NEAR and clear:
        return (fit.moved_to(expected).at,)
    return (fit.at, *_around(expected, turn))


def _around(expected: Expected, turn: float | None) -> list[Posed]:
    """Return what a session expects, and that rotated about the shaft to both sides by ``turn``, rad, if given."""
    mean, turns = expected.mean, (0.0,) if turn is None else (0.0, -turn, turn)
    return [Posed(moved(mean.pose, np.array([0, 0, 0, 0, 0, angle])), mean.joints) for angle in turns]
