"""A recording of one arm that is followed, as `track` follows each of several."""

from __future__ import annotations

from typing import Any

from dvrk_cmaes.calibration.together import solved_alone
from dvrk_cmaes.runs.track_folder import TrackSummary, begin_tracking


def track_folder(*given: Any, **options: Any) -> TrackSummary:
    """Follow the only arm of a recording; parameters and errors as of `begin_tracking`."""
    one = solved_alone(begin_tracking(*given, **options))
    one.write()
    return one.follow()
