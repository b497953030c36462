"""Alternating estimation of a session's calibration and of its frames' poses.

`initialised` finds the camera_from_base that most frames' modes agree on, and faults of the session as a whole.
`solved` then alternates: each frame is fitted to its outline with the session's prediction as a prior, and the
calibration is estimated from all fits.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration
from dvrk_cmaes.calibration.cables import estimate_cables
from dvrk_cmaes.calibration.consensus import Consensus, choose_modes, find_consensus_at_any_roll
from dvrk_cmaes.calibration.endoscope import Pieces
from dvrk_cmaes.calibration.endoscope_search import describe_pieces, with_pieces, without_pieces
from dvrk_cmaes.calibration.faults import check_arm, check_motion
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.frame_task import fit_task, gather_task
from dvrk_cmaes.calibration.imaging import with_camera, with_margins
from dvrk_cmaes.calibration.lasting_estimate import estimate_lasting
from dvrk_cmaes.calibration.linearise import few_of
from dvrk_cmaes.calibration.masks_again import with_masks
from dvrk_cmaes.calibration.model import Deviations
from dvrk_cmaes.calibration.session_camera import IMPLAUSIBLE, camera_undetermined
from dvrk_cmaes.calibration.session_lag import NO_READINGS_AT_LAG
from dvrk_cmaes.calibration.session_masks import margins_of
from dvrk_cmaes.calibration.session_state import LEAST_FRAMES, FoundMasks, SessionState
from dvrk_cmaes.calibration.solve import FrameFits, solution_at, solve, solve_with_modes
from dvrk_cmaes.calibration.starts import first_starts, next_starts
from dvrk_cmaes.calibration.variances import solve_with_variances
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.seen_view import PackedMask
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.expected import Expected

_ROLLED_ITERATIONS = 2  # first iterations, in which frames also start from poses rotated about the shaft
_NEAR = 1.0  # standard deviations per parameter, by which fits move to where the last solution expects them


def with_lag_of_modes(state: SessionState) -> SessionState:
    """Find the lag from the frames' own modes, without correcting the readings."""
    return replace(state, lag=state.lag.searched(state.model, state.modes))


def initialised(state: SessionState) -> SessionState:
    """Find the camera_from_base that most frames agree on, each frame's mode for it, and faults of the session.

    The lag of the state is taken out of the readings.

    Raises
    ------
    InputError
        The arm does not move, the readings only fit another arm or tool, or too few frames remain; or the camera is to
        be refined, and the session does not determine it.
    """
    check_motion(state.model)
    if state.imaging.change is not None and (reason := camera_undetermined(state.model)):
        raise _camera_refused(state, reason)
    state, consensus = _on_one_base(_less_lag(state))
    solution = solve_with_modes(state.model, state.modes, consensus.calibration)
    return replace(state, found=solution)


def _camera_refused(state: SessionState, reason: str) -> InputError:
    """Return the refusal to find the camera of a session that does not tell it."""
    if state.problem.guessed_camera:
        return InputError(f"--camera: expected a camera file, which these frames do not replace: {reason}")
    return InputError(f"--refine-camera: {reason}")


def _less_lag(state: SessionState) -> SessionState:
    """Correct the readings by the lag if it differs from zero."""
    applied = state.lag.applied
    if applied is None:
        return state
    kept = np.flatnonzero(state.lag.has_readings()).tolist()
    state = state.without_others(kept, NO_READINGS_AT_LAG)
    if len(state.frames) < LEAST_FRAMES:
        raise InputError(
            f"session: {applied.describe()}, which leaves {len(state.frames)} frames with readings; "
            f"expected at least {LEAST_FRAMES}"
        )
    return replace(state, model=state.lag.corrected(state.model))


def _on_one_base(state: SessionState) -> tuple[SessionState, Consensus]:
    """Return the consensus of the frames, in pieces if the base moved between them.

    Pieces in which the lag was found are looked for again with the lag taken out: with it, a moving arm seems to have
    another base.
    """
    lost = isinstance(state.model.endoscope, Pieces)
    if lost:
        state = without_pieces(state)
    consensus = find_consensus_at_any_roll(state.model, state.modes)
    if not lost:
        check_arm(state.model, state.modes, consensus)
    cut = with_pieces(state, consensus) if state.model.endoscope is None else None
    if cut is not None:
        state, consensus = cut, find_consensus_at_any_roll(cut.model, cut.modes)
        assert isinstance(cut.model.endoscope, Pieces)
        state = cut.noted(remarks=[describe_pieces(cut.model.endoscope, cut.frames)])
    if lost:
        check_arm(state.model, state.modes, consensus)
    return state, consensus


def solved(state: SessionState) -> SessionState:
    """Gather each frame's evidence, then alternate between fitting all frames and estimating the calibration.

    The standard deviations of the predictions are multiplied by a factor that decreases to 1 over the iterations.
    """
    session, problem = state.problem.config.session, state.problem
    problem.progress("gathering evidence", len(state.frames))
    missing = [frame for frame in state.frames if frame.name not in problem.gathered]
    names = (frame.name for frame in missing)
    problem.gathered.update(zip(names, problem.run(gather_task, missing), strict=True))
    state = replace(state, stored=tuple(problem.gathered[frame.name] for frame in state.frames))
    scales = [*np.geomspace(session.loosened, 1.0, max(session.rounds - 1, 1)).tolist(), 1.0][: session.rounds]
    if problem.refine_camera:
        scales.append(1.0)  # with the camera that all rounds before have found
    state, begun = _begun_with_few(state, scales)
    calibration, moved = state.solution.calibration, None
    for iteration in range(begun, len(scales)):
        state, at = _round(state, iteration, scales, calibration, moved)
        calibration, moved = state.solution.calibration, None
        if iteration + 1 < len(scales) and problem.refine_camera:
            state, calibration, moved = with_camera(state, calibration, at)
        if iteration + 2 == len(scales) and problem.refine_camera and state.imaging.of_change is None:
            raise _camera_refused(state, IMPLAUSIBLE)
        if iteration + 2 == len(scales) and not problem.refine_camera:
            state, calibration, moved = with_margins(state, calibration, at)
    return _finished(state)


def _round(
    state: SessionState, iteration: int, scales: Sequence[float], calibration: Calibration, moved: Posed | None
) -> tuple[SessionState, Posed]:
    """Fit the frames to what the calibration predicts, and estimate the calibration from the fits.

    ``scales`` are the factors on the standard deviations of the predictions, one of each round; ``moved`` is as in
    `_starts`. Also returns the poses of the fits.
    """
    scale, last = scales[iteration], iteration + 1 == len(scales)
    state.problem.progress(f"round {iteration + 1} of {len(scales)}", len(state.frames))
    expected = state.model.priors(calibration, scale=scale)
    state = _fitted(state, expected, _starts(state, iteration, expected, moved, last=last), last=last)
    try:
        # Fits that do not explain the mask are only excluded once the prior is no longer widened.
        return _solved_round(state, calibration, keep_all=scale != 1.0)
    except InputError as error:
        if state.problem.refine_camera and iteration:
            raise _camera_refused(state, IMPLAUSIBLE) from error
        raise


def _begun_with_few(state: SessionState, scales: Sequence[float]) -> tuple[SessionState, int]:
    """Do the rounds whose predictions are widened with few of many frames; also returns the number of these rounds.

    They only serve to find the calibration from which all frames are then fitted. With another camera than the file's,
    the frames' own modes are no starts after them, so all frames take part in all rounds.

    Parameters
    ----------
    state
        The session, initialised.
    scales
        The factors on the standard deviations of the predictions, one of each round.
    """
    index = None if state.problem.refine_camera else few_of(len(state.frames))
    rounds = sum(scale != 1.0 for scale in scales[:-1])  # all frames take part in the last one in any case
    if index is None or rounds == 0:
        return state, 0
    few = _with_modes(state.subset(index.tolist()), state.solution.calibration)
    for iteration in range(rounds):
        few, _ = _round(few, iteration, scales, few.solution.calibration, None)
    lag = state.lag.told_by_few(few.lag)
    model = lag.corrected(replace(state.model, deviations=few.model.deviations))
    return _with_modes(replace(state, lag=lag, model=model), few.solution.calibration), rounds


def _with_modes(state: SessionState, calibration: Calibration) -> SessionState:
    """Return the state with a calibration as its solution, and with what the frames' own modes tell of it."""
    modes = FrameFits.of_modes(choose_modes(state.model, state.modes, calibration))
    return replace(state, found=solution_at(state.model, modes, calibration))


def _solved_round(state: SessionState, calibration: Calibration, *, keep_all: bool) -> tuple[SessionState, Posed]:
    """Estimate the calibration, the cables and the lag from the current fits, whose poses are returned, too.

    ``keep_all`` is whether fits that do not explain the mask count as well. `InputError` if too few do.
    """
    if not keep_all:
        state.check_agreement([state.disagreement(fit) for fit in state.fits])
    fits, problem = state.outlines(keep_all=keep_all), state.problem
    state = _with_calibration(state, fits, calibration)
    if not keep_all and problem.config.session.cables:
        usual = Deviations.of(problem.config.session, state.model.names)
        std = state.model.offset_std[1:]
        cables, alone = estimate_cables(state.model, fits, state.solution, state.lag, usual, std)
        own = cables.deviations(state.model.deviations)
        model = replace(state.model, correction=cables.correction, deviations=own)
        state = replace(state, cables=(cables, alone), model=model)
        if cables.parts:
            state = _with_calibration(state, fits, state.solution.calibration)
    lag = state.lag.refined(state.model, fits, state.solution.calibration)
    return replace(state, lag=lag, model=lag.corrected(state.model)), fits.at


def _with_calibration(state: SessionState, fits: FrameFits, start: Calibration) -> SessionState:
    """Estimate the calibration together with the variances."""
    session = state.problem.config.session
    initial = Deviations.of(session, state.model.names)
    if state.cables is not None:
        initial = state.cables[0].deviations(initial)
    model, solution = solve_with_variances(state.model, fits, start, session, initial)
    return replace(state, model=model, found=solution)


def _finished(state: SessionState) -> SessionState:
    """Solve once more with all that was found from the fits of the last round, and the size of lasting errors."""
    calibration = state.solution.calibration
    state = replace(state, found=solve(state.model, state.outlines(), calibration))
    lasting = estimate_lasting(state.model, state.fits, state.solution, state.times)
    imaging = replace(state.imaging, lasting=lasting)
    state = replace(state, imaging=imaging, fits=tuple(fit.with_size(lasting.size) for fit in state.fits))
    fits = state.outlines()
    solution = solve(state.model, fits, state.solution.calibration)
    pairs = zip(state.fits, state.model.priors(solution.calibration), strict=True)
    near = tuple(fit.moved_to(own) if fit.step_to(own) < _NEAR else fit for fit, own in pairs)
    return replace(state, found=solution, fits=near)


def with_lag_of_fits(state: SessionState) -> tuple[SessionState, float | None]:
    """Determine the lag from the frames' fits where the modes did not; also returns one that is to be tried, or None.

    Where the fits tell that there is none, what is not known of the lag does not widen the solution any more.
    """
    lag, to_try = state.lag.told_by_fits(state.model, state.outlines(), state.solution.calibration)
    state = replace(state, lag=lag)
    return (state if lag.lag is None else _finished(state)), to_try


def with_other_masks(state: SessionState, masks: Mapping[int, Mapping[str, PackedMask]]) -> SessionState:
    """Return a session with other masks of some frames, solved in one more round from the current solution."""
    problem, again = state.problem, list(masks)
    frames, stored = list(state.frames), list(state.stored)
    for i in again:
        frames[i] = frames[i].with_data(partial(with_masks, masks[i]))
    problem.progress("solving again", len(masks))
    for i, of_frame in zip(again, problem.run(gather_task, [frames[i] for i in again]), strict=True):
        stored[i] = of_frame
    first = {i: state.stored[i] for i in again}
    found = FoundMasks({frames[i].name: masks[i] for i in again}, first)
    return fitted_again(replace(state, frames=tuple(frames), stored=tuple(stored), again=found), again)


def fitted_again(state: SessionState, again: Collection[int]) -> SessionState:
    """Return a session solved in one more round from the current one, with new fits of the frames at some indices."""
    calibration = state.solution.calibration
    starts = [(fit.at,) if i in again else () for i, fit in enumerate(state.fits)]
    state = _fitted(state, state.model.priors(calibration), starts, last=True)
    return _finished(_solved_round(state, calibration, keep_all=False)[0])


def _starts(
    state: SessionState, iteration: int, expected: Sequence[Expected], moved: Posed | None, *, last: bool
) -> list[tuple[Posed, ...]]:
    """Return the starts of each frame in an iteration, none where its fit is settled; ``moved`` by a new camera."""
    angle = float(np.deg2rad(state.problem.config.session.turn_deg))
    misfit = state.solution.misfit / (6 + len(state.model.names))
    if not state.fits:
        chosen = choose_modes(state.model, state.modes, state.solution.calibration)
        pairs = zip(state.modes, chosen, misfit, expected, strict=True)
        return [first_starts(*of_frame, angle) for of_frame in pairs]
    turn = angle if iteration < _ROLLED_ITERATIONS else None
    return [
        next_starts(
            fit,
            float(misfit[i]) if fit.explains_mask else np.inf,
            expected[i],
            turn,
            last=last,
            changed=None if moved is None else moved[i],
        )
        for i, fit in enumerate(state.fits)
    ]


def _fitted(
    state: SessionState, expected: Sequence[Expected], starts: Sequence[tuple[Posed, ...]], *, last: bool
) -> SessionState:
    """Fit the frames that have starts, with what the session expects of each as its prior.

    The others keep the linearisation of their outline, whose minimum is their fit in the ``last`` round.
    """
    again, masks = [i for i, of_frame in enumerate(starts) if of_frame], state.imaging.masks
    tasks = []
    for i in again:
        margins = margins_of(masks, [view.name for view in state.stored[i].views])
        tasks.append((state.stored[i], expected[i], starts[i], state.imaging.change, margins))
    fits: dict[int, FrameFit] = dict(enumerate(state.fits))
    if last:
        fits = {i: fit.moved_to(expected[i]) for i, fit in fits.items()}
    fits |= zip(again, state.problem.run(fit_task, tasks), strict=True)
    return replace(state, fits=tuple(fits[i] for i in range(len(state.frames))))
