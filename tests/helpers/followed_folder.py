"""A recording of one arm that is followed, as `track` follows each of several."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from dvrk_cmaes.calibration.together import solved_alone
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.runs.track import TrackedArm, TrackSettings
from dvrk_cmaes.silhouette import Body


def track_folder(
    session: Session,
    out: Path,
    body: Body,
    settings: TrackSettings,
    *,
    video: bool = True,
    page: bool = True,
    stop: threading.Event | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    **told: Any,
) -> TrackedArm:
    """Follow the only arm of a recording; other parameters and errors as of `TrackedArm`."""
    arm = TrackedArm(session, out, body, replace(settings, video=video, page=page), **told)
    solved_alone(arm.begin(stop=stop)).follow(progress)
    return arm
