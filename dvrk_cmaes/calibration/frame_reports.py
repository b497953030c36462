"""What is reported of each frame of a session that was solved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.frame_task import FrameReport, ReportTask, report_task
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_state import SessionState
from dvrk_cmaes.calibration.solve import FrameFits, frame_covariances, leave_one_out
from dvrk_cmaes.config import SessionConfig
from dvrk_cmaes.geometry import Float64, inverse
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.pose.doubts import reading_slipped, reasons
from dvrk_cmaes.results.result import Result


def reported(state: SessionState, camera_errors: Float64) -> tuple[list[FrameReport], dict[str, str]]:
    """Return the reports of the frames in use, and by name the reason for each frame that is left out.

    Parameters
    ----------
    state
        The session, solved; its evidence is as seen by the camera that is used.
    camera_errors : (5, 5)
        Covariance of the camera that is used.

    Raises
    ------
    InputError
        Too few frames agree with the calibration.
    """
    problem, model, solution, growth = state.problem, state.model, state.solution, state.imaging.growth
    problem.progress("leaving one out", len(state.frames))
    disagreements = state.disagreements
    state.check_agreement(disagreements)
    named = zip(state.frames, disagreements, strict=True)
    reasons = {**state.notes.left_out, **{frame.name: text for frame, text in named if text}}
    stated = {**problem.config.as_dict(), "instrument": problem.instrument.describe_limits(problem.arm)}
    first = {} if state.again is None else state.again.first
    # what errors of all masks do to a frame is told with what they do to its own mask
    covariances = frame_covariances(model, FrameFits.of(state.fits), replace(solution, of_growth=None))
    base_from_root, tasks = model.base_from_root(solution.calibration.offsets), []
    for i, (fit, result) in enumerate(zip(state.fits, _results(state), strict=True)):
        alone, without = model.subset([i]), leave_one_out(solution, i)
        jacobian = alone.jacobian(without)[0]
        spread = alone.covariance(without)[0] + jacobian @ solution.covariance @ jacobian.T
        covariance = covariances[i]
        if growth is not None:
            covariance += growth.of_frames[i] @ growth.squares @ growth.of_frames[i].T
        by_fit = not disagreements[i] and not state.frames[i].brief
        tasks.append(
            ReportTask(
                state.stored[i],
                replace(result, config=stated) if by_fit else result,
                fit,
                covariance,
                alone.predict(without)[0],
                np.sqrt(np.diag(spread)[6:]),
                np.asarray(fit.at.pose @ inverse(base_from_root[i])),
                (*([disagreements[i]] if disagreements[i] else ()), *_describe_slips(model, i, problem.config.session)),
                agree=not disagreements[i],
                first=first.get(i),
                change=state.imaging.change,
                camera_errors=camera_errors,
                brief=state.frames[i].brief,
            )
        )
    return problem.run(report_task, tasks), reasons


def _results(state: SessionState) -> list[Result]:
    """Return the frames' own results; with the readings of the model, if a lag is taken out of them."""
    results, model = [frame.result for frame in state.frames], state.model
    if state.lag.applied is None:
        return results
    names, values = (*OUTER_JOINTS, *model.names), np.concatenate([model.outer, model.joints], axis=1)
    rows = [{name: v for name, v in zip(names, row, strict=True) if not np.isnan(v)} for row in values.tolist()]
    if isinstance(model.endoscope, Steered):
        ecm = [dict(zip(ECM_JOINTS, row, strict=True)) for row in model.endoscope.read.tolist()]
    else:
        ecm = [{name: own.readings[name] for name in ECM_JOINTS if name in own.readings} for own in results]
    return [replace(own, readings={**row, **of_ecm}) for own, row, of_ecm in zip(results, rows, ecm, strict=True)]


def _describe_slips(model: SessionModel, i: int, config: SessionConfig) -> list[str]:
    """Describe the joints whose readings have a large error in one frame, one text for each joint."""
    stds = np.array([model.deviations.outer[3], *model.deviations.joints])
    sigmas = model.inflation[i] * config.tail
    errors = zip(("roll", *model.names), np.degrees(sigmas * stds).tolist(), sigmas.tolist(), strict=True)
    return reasons(*(reading_slipped(*error) for error in errors))
