"""Plots of what cables do to a session's readings: the joints' errors against their readings, and against time.

As in panels.py, coordinates in the drawing are computed here; the template makes the SVG.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.session_cables import SessionCables
from dvrk_cmaes.report.page_session import correction
from dvrk_cmaes.report.plots.axes import value_axis
from dvrk_cmaes.report.plots.panels import SHAPES, Mark, Panel, Plot, Series, mark_size
from dvrk_cmaes.results.result import Result

_WIDTH, _HEIGHT = 360.0, 230.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 338.0, 12.0, 176.0
_LEAST_SPAN = 1.0  # deg or s, of an axis


def cables_plot(results: Sequence[Result], calibration: SessionCalibration, used: frozenset[int]) -> Plot | None:
    """Plot the errors of the instrument's joints that were found in the frames, and those that the others predict.

    Parameters
    ----------
    results
        Results in the order of the page.
    calibration
        The session's calibration.
    used
        Indices of the frames that the calibration used.

    Returns
    -------
    Plot or None
        Two panels a joint, over its reading and over time; None if the session does not tell of its cables.
    """
    cables = calibration.cables
    if cables is None:
        return None
    panels: list[Panel] = []
    for name in tuple(calibration.offsets)[2:]:
        panels += _panels(name, results, calibration, cables, used)
    return Plot("cables", 0.7 * mark_size(len(used)), tuple(panels)) if panels else None


def _panels(
    name: str, results: Sequence[Result], calibration: SessionCalibration, cables: SessionCables, used: frozenset[int]
) -> list[Panel]:
    """Return the panels of one joint; none if it was not read."""
    index, places, rows = cables.joints.index(name), [], []
    for place in sorted(used):
        result = results[place]
        found = correction(result, name)
        known = cables.corrections.get(result.frame)
        if found is not None and known is not None:
            predicted = calibration.offsets[name] + known[index]
            angles = np.degrees([result.readings[name], found, predicted])
            rows.append((*angles.tolist(), cables.times.get(result.frame, np.nan)))
            places.append((place, result.status == "ok"))
    if not rows:
        return []
    readings, found_deg, predicted_deg, times = np.array(rows).T
    errors = found_deg.min(), predicted_deg.min(), found_deg.max(), predicted_deg.max(), 0.0
    label = f"error of {name}, deg"
    up = value_axis(label, min(errors), max(errors), start=_BOTTOM, end=_TOP, most=5, least=_LEAST_SPAN)
    abscissas = [(f"reading of {name}, deg", readings)]
    if not np.isnan(times).any():
        timed = all(results[place].time is not None for place, _ in places)
        abscissas.append(("time, s" if timed else "time at 30 images a second, s", times - times.min()))
    panels = []
    for label, values in abscissas:
        ends = float(values.min()), float(values.max())
        across = value_axis(label, *ends, start=_LEFT, end=_RIGHT, most=5, least=_LEAST_SPAN)
        drawn = [
            Series(
                text,
                shape,
                tuple(
                    Mark(place, across.at(float(x)), up.at(float(y)), sure)
                    for (place, sure), x, y in zip(places, values, errors, strict=True)
                ),
            )
            for text, shape, errors in (("found", SHAPES[0], found_deg), ("predicted", SHAPES[3], predicted_deg))
        ]
        panels.append(Panel(_WIDTH, _HEIGHT, across, up, tuple(drawn), zero=up.at(0.0)))
    return panels
