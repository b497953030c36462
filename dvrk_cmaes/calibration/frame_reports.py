"""Which of a session's frames agree with its calibration, and what is to be reported of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.frame_task import ReportTask, SessionFrame
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_doubts import DISAGREES
from dvrk_cmaes.calibration.solve import FrameFits, Solution, frame_covariances, leave_one_out
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.names import ECM_JOINTS

_MOST_NAMED = 4
_TO_TRY = "try another --instrument, --tool or --arm, other readings, or the lag of all rows of the recording"
_SLIP = 4.0  # standard deviations beyond which a joint's reading is reported


def describe_disagreements(fits: Sequence[FrameFit], solution: Solution, config: SessionConfig) -> list[str]:
    """Describe why each of N frames disagrees with the calibration; an empty text where it agrees."""
    texts = []
    for fit, misfit in zip(fits, solution.misfit, strict=True):
        dimension = len(fit.slope)
        text = ""
        if not misfit < config.largest_misfit * dimension:
            text = f"{np.sqrt(misfit / dimension):.1f} times the expected error from what it expects"
        elif not fit.explains_mask:
            text = fit.describe_overlap()
        texts.append(text and f"{DISAGREES}: {text}")
    return texts


def check_agreement(frames: Sequence[SessionFrame], disagreements: Sequence[str], least: int) -> None:
    """Refuse a session of which too few frames agree.

    Parameters
    ----------
    frames, disagreements
        The frames, and why each disagrees; an empty text where it agrees.
    least
        Number of frames that must agree.

    Raises
    ------
    InputError
        Fewer agree: names those that do not, with by how much, and what to try.
    """
    off = [
        f"{frame.name} {text.removeprefix(f'{DISAGREES}: ')}"
        for frame, text in zip(frames, disagreements, strict=True)
        if text
    ]
    if len(frames) - len(off) >= least:
        return
    more = f"; and {len(off) - _MOST_NAMED} more" if len(off) > _MOST_NAMED else ""
    raise InputError(
        f"session: expected at least {least} frames that agree on where the arm's base is, got "
        f"{len(frames) - len(off)} of {len(frames)} ({'; '.join(off[:_MOST_NAMED])}{more}): {_TO_TRY}"
    )


def report_tasks(
    frames: Sequence[SessionFrame],
    stored: Sequence[StoredFrame],
    fits: Sequence[FrameFit],
    model: SessionModel,
    solution: Solution,
    disagreements: Sequence[str],
    config: SessionConfig,
    stated: Mapping[str, Any],
) -> list[ReportTask]:
    """Return the tasks that report each of N frames.

    Parameters
    ----------
    frames, stored, fits
        The frames with the readings of the model, their evidence and their fits.
    model, solution
        The model of the same frames and the solution.
    disagreements
        The texts of `describe_disagreements`.
    config, stated
        The settings of sessions, and what the results state of all settings.
    """
    # what errors of all masks do to a frame is told with what they do to its own mask
    covariance = frame_covariances(model, FrameFits.of(fits), replace(solution, of_growth=None))
    base_from_root = model.base_from_root(solution.calibration.offsets)
    tasks = []
    for i, fit in enumerate(fits):
        alone, without = model.subset([i]), leave_one_out(solution, i)
        jacobian = alone.jacobian(without)[0]
        spread = alone.covariance(without)[0] + jacobian @ solution.covariance @ jacobian.T
        doubts = [disagreements[i]] if disagreements[i] else []
        tasks.append(
            ReportTask(
                stored[i],
                frames[i].result,
                fit,
                covariance[i],
                alone.predict(without)[0],
                np.sqrt(np.diag(spread)[6:]),
                np.asarray(fit.at.pose @ inverse(base_from_root[i])),
                (*doubts, *_describe_slips(model, i, config)),
                agree=not disagreements[i],
                config=stated,
                brief=frames[i].brief,
            )
        )
    return tasks


def with_readings(frames: Sequence[SessionFrame], model: SessionModel) -> list[SessionFrame]:
    """Return the N frames of a model with the readings of the model."""
    names = (*OUTER_JOINTS, *model.names)
    rows = np.concatenate([model.outer, model.joints], axis=1)
    ecm: list[dict[str, float]] = [
        {name: own.result.readings[name] for name in ECM_JOINTS if name in own.result.readings} for own in frames
    ]
    if isinstance(model.endoscope, Steered):
        ecm = [{name: row[k] for k, name in enumerate(ECM_JOINTS)} for row in model.endoscope.read.tolist()]
    readings = [{n: float(v) for n, v in zip(names, row, strict=True) if not np.isnan(v)} for row in rows]
    return [
        replace(frame, result=replace(frame.result, readings={**own, **of_ecm}))
        for frame, own, of_ecm in zip(frames, readings, ecm, strict=True)
    ]


def _describe_slips(model: SessionModel, i: int, config: SessionConfig) -> list[str]:
    """Describe the joints whose readings have a large error in one frame, one text for each joint."""
    stds = [model.deviations.outer[3], *model.deviations.joints]
    texts = []
    for name, factor, std in zip(("roll", *model.names), model.inflation[i], stds, strict=True):
        error = factor * config.tail  # in standard deviations
        if error > _SLIP:
            degrees = np.degrees(error * std)
            texts.append(f"reading of {name}: {degrees:.0f} deg off in this frame, beyond the session's offset")
    return texts
