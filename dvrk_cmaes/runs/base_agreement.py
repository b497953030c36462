"""Agreement of a session's frames on the base of the arm: frames whose base lies far from the others' are doubtful.

The base does not move during a session, so each frame's camera_from_base should have one rotation. A frame that differs
is in another mode, or its readings are of another time. How far is far depends on the session: a roll that is read
wrongly turns the base about another axis in each frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import ecm_readings
from dvrk_cmaes.evaluate.consistency import spread_of_bases
from dvrk_cmaes.pose.doubts import BASE_APART, base_apart
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.output import update_result

FEWEST = 5
"""Least number of frames whose bases are compared."""

_SPREADS = 3.0  # median distances from the most central base, beyond which a frame differs


def compare_bases(out: Path, results: Mapping[str, Result], limit_deg: float) -> dict[str, Result]:
    """Return results in which frames whose base is far from the others' are doubtful, and update their files.

    Reasons of an earlier comparison are replaced, so that the files depend only on the frames that are there.
    """
    far = base_doubts(results, limit_deg)
    compared = {}
    for name, result in results.items():
        compared[name] = now = by_itself(result, [far[name]] if name in far else ())
        if now is not result:
            update_result(out, name, status=now.status, reasons=list(now.reasons))
    return compared


def by_itself(result: Result, further: Sequence[str] = ()) -> Result:
    """Return a result without the reasons that come from a comparison of all frames, and with others of these."""
    reasons = (*(reason for reason in result.reasons if not reason.startswith(BASE_APART)), *further)
    if reasons == result.reasons:
        return result
    return replace(result, reasons=reasons, status="doubtful" if reasons else "ok")


def base_doubts(results: Mapping[str, Result], limit_deg: float) -> dict[str, str]:
    """Return the reason, in words, of each frame whose base is far from the others', by name.

    Compared are the frames that were solved by themselves and have a base. Far is a rotation from the most central base
    by more than ``limit_deg`` and by more than three times the median of all frames. Where the endoscope's arm is read
    and moves, frames at one place are compared with each other.
    """
    bases = {
        name: result.camera_from_base
        for name, result in results.items()
        if result.camera_from_base is not None and result.source == "frame"
    }
    if len(bases) < FEWEST:
        return {}
    steered = Steered.of(ecm_readings([results[name].readings for name in bases]))
    places = np.zeros(len(bases), np.intp) if steered is None else steered.place
    reasons: dict[str, str] = {}
    for place in sorted(set(places[places >= 0].tolist())):
        there = [name for name, own in zip(bases, places, strict=True) if own == place]
        if len(there) < FEWEST:
            continue
        angles = spread_of_bases(np.stack([bases[name] for name in there])).angles_deg
        limit = max(limit_deg, _SPREADS * float(np.median(angles)))
        reasons |= {
            name: text
            for name, angle in zip(there, angles, strict=True)
            if (text := base_apart(float(angle), limit)) is not None
        }
    return {name: reasons[name] for name in bases if name in reasons}
