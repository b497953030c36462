"""Figure of a comparison: the differences of the tips over the frames, and their distribution for each set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from dvrk_cmaes.draw.figure import new_figure
from dvrk_cmaes.evaluate.comparison import Comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS: Final = ("#0072b2", "#d55e00", "#00855f", "#a3457f", "#6b6b00")
_MOST_NAMES: Final = 12


def draw_comparison(comparison: Comparison) -> Figure:
    """Draw the tips' distance (of the root, where tips are not known) from the reference, mm: by frame, and sorted."""
    figure = new_figure(11.0, 4.2)
    by_frame, ranked = figure.subplots(1, 2, width_ratios=(2, 1), sharey=True)
    places = {frame: place for place, frame in enumerate(comparison.frames)}
    for k in comparison.others:
        found = comparison.differences[k]
        sizes = np.array([pair.size[0] for pair in found.values()])
        colour = _COLOURS[k % len(_COLOURS)]
        label = f"{comparison.labels[k]}: {comparison.sets[k].path}"
        by_frame.plot([places[frame] for frame in found], sizes, "o", color=colour, markersize=4, label=label)
        if len(sizes):
            ranked.ecdf(sizes, orientation="horizontal", color=colour)
    step = max(1, -(-len(places) // _MOST_NAMES))
    by_frame.set_xticks(range(0, len(places), step), comparison.frames[::step], rotation=45, ha="right", fontsize=7)
    reference = comparison.sets[comparison.reference]
    by_frame.set_ylabel(f"distance of the tips from {comparison.labels[comparison.reference]}, mm")
    by_frame.set_title(f"{comparison.labels[comparison.reference]}: {reference.path} ({reference.kind})", fontsize=9)
    by_frame.set_ylim(bottom=0)
    by_frame.legend(fontsize=8)
    ranked.set_xlabel("share of the frames that are nearer")
    for panel in (by_frame, ranked):
        panel.grid(alpha=0.25)
    return figure
