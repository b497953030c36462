"""What a session's frames tell of its cameras and its masks, beside the base, the readings' errors and the poses.

A change of the camera and the margin of each view's masks are each estimated from the outlines of all frames,
linearised about the current fits. The functions `with_camera` and `with_margins` take a session, the calibration and
the frames' poses with cameras and masks as they are, and return the session with those that were estimated, the
calibration, and the poses (N) with them, None if nothing changed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.blocks import Calibration, SeenBlock
from dvrk_cmaes.calibration.frame_task import gather_task, with_changed_cameras
from dvrk_cmaes.calibration.linearise import FramesAt, SessionOutlines
from dvrk_cmaes.calibration.mask_growth import MaskGrowth
from dvrk_cmaes.calibration.session_camera import (
    CameraChange,
    CameraCheck,
    check_camera,
    estimate_camera,
    file_deviations,
)
from dvrk_cmaes.calibration.session_lens import Lens
from dvrk_cmaes.calibration.session_masks import MaskMargin, estimate_margin
from dvrk_cmaes.calibration.session_shaft import InstrumentSizes
from dvrk_cmaes.calibration.session_state import SessionState
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Posed

Changed = tuple[SessionState, Calibration, Posed | None]

TESTED: Final[tuple[Callable[[EstimateConfig, Camera], SeenBlock], ...]] = (Lens,)
"""What makes the further blocks that every session is tested for, each of which states itself."""

_CAMERA_PASSES = 2  # linearisations of the outlines about the camera between two fits of the frames


def with_camera(state: SessionState, calibration: Calibration, at: Posed) -> Changed:
    """Estimate the change of the camera, and use it where it is plausible; else the session has no covariance of it."""
    frames, config = FramesAt(state.model, calibration, at), state.problem.config
    estimate = estimate_camera(frames, config, _outlines(state), passes=_CAMERA_PASSES)
    if not estimate.plausible:
        return replace(state, imaging=replace(state.imaging, of_change=None)), calibration, None
    changed = replace(state, imaging=replace(state.imaging, change=estimate.change, of_change=estimate.covariance))
    return changed, estimate.calibration, estimate.at


def with_margins(state: SessionState, calibration: Calibration, at: Posed) -> Changed:
    """Estimate the margin of each view's masks, and take it off if it is clear."""
    names = list(dict.fromkeys(view.name for stored in state.stored for view in stored.views))
    of_all = FramesAt(state.model, calibration, at)
    found = [estimate_margin(of_all, _outlines(state, name, file_tells=True)) for name in names]
    margins = tuple((name, margin) for name, (margin, _, _) in zip(names, found, strict=True))
    state = replace(state, imaging=replace(state.imaging, margins=margins))
    applied = ((own, moved) for margin, own, moved in found if margin.applied)
    return (state, *next(applied, (calibration, None)))


def checked_camera(state: SessionState) -> tuple[SessionState, CameraCheck]:
    """Test whether the frames contradict the camera file.

    The evidence of the returned session is as seen by the camera that is used.
    """
    problem, change = state.problem, state.imaging.change
    problem.progress("checking the camera", len(state.frames))
    at, config = Posed.stacked(fit.at for fit in state.fits), problem.config
    of_all = FramesAt(state.model, state.solution.calibration, at)
    outlines = _outlines(state)
    masks = state.imaging.masks
    offsets = [fit.side_offsets for fit in state.fits if fit.explains_mask and fit.side_offsets is not None]
    outwards = max(0.0, *np.mean(offsets, axis=0).tolist()) if offsets else 0.0
    growth = MaskGrowth(outwards, 0.0 if masks is None else masks.taken_off)
    tested = growth, InstrumentSizes(problem.instrument), *(make(config, outlines.camera) for make in TESTED)
    outlines = replace(outlines, blocks=(*outlines.blocks, *tested))
    check = check_camera(of_all, config, outlines, applied=change)
    if check.growth is not None:
        moves = check.growth.of_calibration
        widened = replace(state.solution, of_growth=moves @ check.growth.squares @ moves.T)
        imaging = replace(state.imaging, growth=check.growth)
        state = replace(state, found=widened, imaging=imaging)
    if check.camera is None:
        state = state.noted(undetermined=[check.undetermined])
    elif problem.guessed_camera:
        state = state.noted(remarks=[check.camera.describe_found(state.stored[0].camera)])
    elif check.camera.applied:
        state = state.noted(remarks=check.camera.contradictions())
    if check.shaft is not None and not (check.camera and check.camera.contradicts):
        state = state.noted(remarks=check.shaft.hints())
    if change is not None:
        frames = [frame.with_data(partial(with_changed_cameras, change)) for frame in state.frames]
        state = replace(state, stored=tuple(problem.run(gather_task, frames)))
    return state, check


def _outlines(state: SessionState, view: str | None = None, *, file_tells: bool = False) -> SessionOutlines:
    """Return the outlines of all frames in a view, as functions of the camera and the margin.

    ``view`` is by default that of the reference camera; of another one if it does not show the instrument in any frame.
    ``file_tells`` is whether the camera's file counts as a measurement.
    """
    shown = [stored for stored in state.stored if stored.in_reference] or state.stored
    name = str(shown[0].views[0].name) if view is None else view
    pairs = zip(state.fits, state.stored, strict=True)
    numbers = [stored.number_of(name) if fit.explains_mask else None for fit, stored in pairs]
    views = [() if number is None else (number,) for number in numbers]
    return SessionOutlines(
        state.stored,
        views,
        state.problem.run,
        state.common,
        (_camera(state, file_tells=file_tells), _margin(state, name)),
    )


def _camera(state: SessionState, *, file_tells: bool) -> CameraChange:
    """Return the change of the camera as a block that starts where it is."""
    file = file_deviations(state.stored[0].camera, state.problem.config.camera) if file_tells else None
    return CameraChange(file, state.imaging.change)


def _margin(state: SessionState, view: str | None) -> MaskMargin:
    """Return the margin of a view's masks, by default the first one's, as a block that starts where it is."""
    masks = state.imaging.masks
    if masks is None:
        return MaskMargin()
    return MaskMargin(masks.taken_off if view is None else masks.taken_off_in(view))
