"""The lag that a batch takes out of a session's readings: given, a calibration's, or found from some of the frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.calibrate import find_lag
from dvrk_cmaes.calibration.frame_task import SessionFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.io.output import check_output_folder
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.runs.batch import BatchSummary
from dvrk_cmaes.runs.output import COMMAND

LAG: Final = "lag"
"""Folder, below that of the results, of the results from which the lag is found."""

_FRAMES = 60  # from which a lag is found, evenly spaced


def find_batch_lag(
    session: Session,
    out: Path,
    run: Callable[[Session, Path], BatchSummary],
    instrument: Instrument,
    config: EstimateConfig,
    arm: Arm,
) -> tuple[Lag | None, str]:
    """Estimate up to 60 frames of a session in OUT/lag, and find the lag of its images behind its readings from them.

    Returns the lag, None if there is none to take out, and a text about it.

    ``run`` estimates the frames of a session with `run_batch` and writes them to a folder; the other parameters are
    those of `run_batch`.

    Raises
    ------
    InputError
        As `run_batch`, or too few frames have a pose and the readings of all outer joints.
    DvrkCmaesError
        As `run_batch`, or the batch was interrupted.
    """
    check_output_folder(out, COMMAND)
    index = np.unique(np.linspace(0, len(session.frames) - 1, min(_FRAMES, len(session.frames))).round().astype(int))
    some = replace(session, frames=tuple(session.frames[i] for i in index))
    done = run(some, out / LAG)
    if done.interrupted:
        raise DvrkCmaesError(f"interrupted while the lag was searched; the same command goes on from {out / LAG}")
    frames = [
        SessionFrame(files.name, partial(read_frame, files, session.camera), done.results[files.name])
        for files in some.frames
    ]
    lag, untold = find_lag(frames, instrument, series=session.reading_series(), arm=arm, config=config)
    if lag is None:
        return None, f"lag: not determined by these frames ({untold}): none is taken out"
    if not lag.applied:
        return None, f"lag: zero within its standard deviation ({lag.describe()}): none is taken out"
    return lag, f"lag: {lag.describe()}: taken out"
