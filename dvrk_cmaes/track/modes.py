"""Decision between the modes of the pose that are followed side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dvrk_cmaes.track.hypothesis import Hypothesis
from dvrk_cmaes.track.update import Fit

_LEAST_GAP = 7.0  # difference of scores beyond which a mode is dropped
_LEAST_PROBABILITY = 0.9  # of the best mode for it to be decided


@dataclass(frozen=True, eq=False)
class Decision:
    """The modes that are kept, the one to be believed first; its fit; and reasons to doubt it.

    ``switched`` tells whether it is another one than before.
    """

    kept: list[Hypothesis]
    fit: Fit
    reasons: tuple[str, ...]
    switched: bool


def pruned(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Drop improbable modes; the scores of the others become differences from the best."""
    best = min(mode.score for mode in hypotheses)
    return [replace(mode, score=mode.score - best) for mode in hypotheses if mode.score - best < _LEAST_GAP]


def decide(fits: Sequence[tuple[Hypothesis, Fit]]) -> Decision:
    """Decide which mode to believe; the first one is left only if another is much more probable, or it was dropped."""
    kept = pruned([mode for mode, _ in fits])
    chances = np.exp(-np.array([mode.score for mode in kept]))
    chances /= chances.sum()
    best, reasons = int(np.argmax(chances)), []
    dropped = kept[0].relation != fits[0][0].relation
    if dropped or chances[best] > _LEAST_PROBABILITY:
        kept.insert(0, kept.pop(best))
        chances = np.array([chances[best], *np.delete(chances, best)])
    switched = kept[0].relation != fits[0][0].relation
    if switched:
        reasons.append(f"switched to {_name(kept[0])}: it explains the images better")
    if len(kept) > 1 and chances[0] < _LEAST_PROBABILITY:
        reasons.append(f"mode undecided: {_name(kept[1])} explains the images nearly as well")
    fit = next(fit for mode, fit in fits if mode.relation == kept[0].relation)
    return Decision(kept, fit, tuple(reasons), switched)


def _name(mode: Hypothesis) -> str:
    """Return the name of a mode in sentences."""
    return f"the {mode.relation}" if mode.relation else "the mode of the first image"
