"""What a session is estimated from, and how far its estimation is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from dvrk_cmaes.calibration.cables import CableFit
from dvrk_cmaes.calibration.consensus import Mode
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.frame_task import Run, SessionFrame
from dvrk_cmaes.calibration.lasting_errors import USUAL_SIZE, CommonErrors
from dvrk_cmaes.calibration.lasting_estimate import LastingEstimate
from dvrk_cmaes.calibration.mask_growth import GrowthEstimate
from dvrk_cmaes.calibration.masks_again import MasksAgain
from dvrk_cmaes.calibration.model import SessionModel
from dvrk_cmaes.calibration.session_lag import LagEstimate
from dvrk_cmaes.calibration.session_masks import Margin, SessionMasks
from dvrk_cmaes.calibration.session_rig import ViewRotation
from dvrk_cmaes.calibration.solve import FrameFits, Solved, leave_one_out
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.seen_view import PackedMask
from dvrk_cmaes.geometry import Float64, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import DISAGREES, frame_disagrees

LEAST_FRAMES = 3
"""Smallest number of frames from which a session can be calibrated."""

_MOST_NAMED = 4
_TO_TRY = (
    "try another --instrument, --tool or --arm, other readings, the lag of all rows of the recording, or --lag auto "
    "for postures whose rows have no times"
)


@dataclass(frozen=True, eq=False)
class SessionProblem:
    """What a session is estimated with, beside its frames.

    ``series`` are the readings as functions of time, with the frames' times; None if the lag is not to be estimated.
    ``instrument``, ``arm`` and ``config`` are the instrument, the kinematics of the outer arm and all settings. ``run``
    applies a function to many tasks, ``progress`` is called before each stage with its name and the number of frames.
    ``refine_camera`` is whether the change of the camera that the frames fit is used, ``guessed_camera`` whether the
    frames' camera is a guess, of which there is no file. ``may_cut`` is whether the session may be cut into pieces
    between which the base moved. ``lag`` is the one that is taken out of the readings, ``auto`` to look for it in those
    of postures, too, as of `LagEstimate.of`. ``gathered`` keeps the frames' evidence by name, for all solutions.
    """

    series: ReadingSeries | None
    instrument: Instrument
    arm: Arm
    config: EstimateConfig
    run: Run[Any, Any]
    progress: Callable[[str, int], None] = lambda stage, count: None
    refine_camera: bool = False
    guessed_camera: bool = False
    may_cut: bool = True
    lag: Lag | Literal["auto"] | None = None
    gathered: dict[str, StoredFrame] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Imaging:
    """What is known of a session's cameras and masks.

    ``change`` (3,) is that of the camera, as of `changed`, None where the camera's file is used, and ``of_change``
    (3, 3) its covariance, None until it is estimated; ``rig`` what the
    further views differ in from the file; ``margins`` those of the views' masks by name, in the views' order, empty
    until they are estimated; ``lasting`` the size of the masks' errors that last, ``growth`` what is told of their
    errors on some sides, both None until they are estimated.
    """

    change: Float64 | None = None
    of_change: Float64 | None = None
    rig: tuple[ViewRotation, ...] = ()
    margins: tuple[tuple[str, Margin], ...] = ()
    lasting: LastingEstimate | None = None
    growth: GrowthEstimate | None = None

    def with_others(self, others: Sequence[Imaging]) -> Imaging:
        """Return the same with the margins, and the change of the camera where it is used, that several arms tell.

        Each is the mean by the covariances of what the arms tell by themselves.
        """
        margins = []
        for view, own in self.margins:
            told = [own, *(margin for other in others for name, margin in other.margins if name == view)]
            value, square = _mean([np.array([one.px]) for one in told], [np.array([[one.std_px**2]]) for one in told])
            margins.append((view, Margin.of(float(value[0]), float(np.sqrt(square[0, 0])))))
        pairs = [(one.change, one.of_change) for one in (self, *others)]
        known = [(change, square) for change, square in pairs if change is not None and square is not None]
        if len(known) < len(pairs):
            return replace(self, margins=tuple(margins))
        change, square = _mean([change for change, _ in known], [square for _, square in known])
        return replace(self, margins=tuple(margins), change=change, of_change=square)

    @property
    def masks(self) -> SessionMasks | None:
        """What is stated of errors that the masks share; None if their margin was not estimated."""
        return SessionMasks.of(self.margins, self.lasting, self.growth) if self.margins else None


def _mean(values: Sequence[Float64], squares: Sequence[Float64]) -> tuple[Float64, Float64]:
    """Return the mean (K,) of values by their covariances (K, K), and its covariance."""
    informations = np.linalg.inv(np.array(squares))
    covariance = np.linalg.inv(informations.sum(axis=0))
    return covariance @ np.einsum("nij,nj->i", informations, np.array(values)), covariance


@dataclass(frozen=True)
class Notes:
    """Texts about a session.

    ``remarks`` are about faults of the session as a whole that are put right, ``undetermined`` about what it does not
    determine; ``left_out`` are the reasons for which frames are left out, by name.
    """

    remarks: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FoundMasks:
    """Masks that were found again and are used, by frame and view, and the ``first`` evidence of these frames by index.

    ``compared`` tells what changed, None before that is known.
    """

    masks: Mapping[str, Mapping[str, PackedMask]] = field(default_factory=dict)
    first: Mapping[int, StoredFrame] = field(default_factory=dict)
    compared: MasksAgain | None = None


@dataclass(frozen=True, eq=False)
class SessionState:
    """How far the estimation of a session is.

    ``frames`` are the N frames in use, ``modes`` those of each and ``model`` the model of their readings; ``lag`` is
    the estimate of the lag of the images behind the readings, ``cables`` are the fits
    of what cables do to readings, as of `fit_cables`, None before the first. ``stored``
    is the frames' evidence and ``fits`` are their current fits, both empty before the first round. ``found`` is the
    current solution, None before the first one. ``again`` are masks that were found again, None where they were not.
    """

    problem: SessionProblem
    frames: tuple[SessionFrame, ...]
    modes: tuple[Sequence[Mode], ...]
    model: SessionModel
    lag: LagEstimate
    imaging: Imaging
    cables: tuple[CableFit, CableFit] | None = None
    notes: Notes = Notes()
    stored: tuple[StoredFrame, ...] = ()
    fits: tuple[FrameFit, ...] = ()
    found: Solved | None = None
    again: FoundMasks | None = None

    @classmethod
    def of(
        cls, problem: SessionProblem, frames: Sequence[SessionFrame], rig: tuple[ViewRotation, ...] = ()
    ) -> SessionState:
        """Return the state before anything is estimated.

        Parameters
        ----------
        problem
            What the session is estimated with.
        frames
            Frames with a pose, its covariance and readings of all outer joints, in the order they were taken.
        rig
            The rotations of the further views against the file that the frames' own results tell; those that are clear
            are taken out of the frames.
        """
        readings, names = [frame.result.readings for frame in frames], problem.instrument.joint_names
        model = SessionModel.of(readings, problem.instrument, problem.config, problem.arm)
        return cls(
            problem,
            tuple(frames),
            tuple(Mode.all_of(frame.result, names) for frame in frames),
            model,
            LagEstimate.of(problem.series, [frame.name for frame in frames], model.deviations.outer, problem.lag),
            Imaging(np.zeros(3) if problem.refine_camera else None, rig=rig),
        )

    @property
    def solution(self) -> Solved:
        """The current solution."""
        assert self.found is not None
        return self.found

    def subset(self, index: Sequence[int]) -> SessionState:
        """Return the state of the frames at some indices, before their first fit."""
        return replace(
            self,
            frames=tuple(self.frames[i] for i in index),
            modes=tuple(self.modes[i] for i in index),
            model=self.model.subset(index),
            lag=self.lag.subset(index),
            stored=tuple(self.stored[i] for i in index) if self.stored else (),
        )

    def without_others(self, kept: Sequence[int], reason: str) -> SessionState:
        """Return the state of only the frames at some indices; the others are left out for a reason."""
        names = {self.frames[i].name for i in kept}
        left_out = {frame.name: reason for frame in self.frames if frame.name not in names}
        return replace(self.subset(kept), notes=replace(self.notes, left_out={**self.notes.left_out, **left_out}))

    def noted(self, *, remarks: Sequence[str] = (), undetermined: Sequence[str] = ()) -> SessionState:
        """Return the state with further texts."""
        notes = self.notes
        both = (*notes.remarks, *remarks), (*notes.undetermined, *undetermined)
        return replace(self, notes=replace(notes, remarks=both[0], undetermined=both[1]))

    @property
    def times(self) -> Float64:
        """Times (N,) of the frames, s; NaN where unknown."""
        read = self.lag.seconds()
        return np.full(len(self.frames), np.nan) if read is None else read

    @property
    def common(self) -> CommonErrors:
        """The errors that the frames share."""
        by_lag = self.lag.change_of_predictions(self.model, self.solution.calibration)
        size = USUAL_SIZE if self.imaging.lasting is None else self.imaging.lasting.size
        return CommonErrors(size, self.times, by_lag, self.problem.config.session.alike_seconds)

    def outlines(self, *, keep_all: bool = False) -> FrameFits:
        """Return the current fits; without the outlines that do not explain the mask, unless ``keep_all``."""
        fits = [fit if fit.explains_mask or keep_all else fit.without_outline() for fit in self.fits]
        terms = [fit.whole_outline for fit in fits]
        return FrameFits.with_lasting(Posed.stacked(fit.at for fit in fits), terms, self.common)

    @property
    def disagreements(self) -> list[str]:
        """Why each frame disagrees with the calibration; an empty text where it agrees."""
        misfits = self.solution.misfit / (6 + len(self.model.names))
        return [self.disagreement(fit, misfit) for fit, misfit in zip(self.fits, misfits.tolist(), strict=True)]

    def disagreement(self, fit: FrameFit, misfit: float = 0.0) -> str:
        """Say why a fit disagrees, whose squared distance from what is expected, per parameter, is ``misfit``."""
        most = self.problem.config.session.largest_misfit
        return frame_disagrees(misfit, most, None if fit.explains_mask else (fit.iou, fit.own_iou)) or ""

    def check_agreement(self, disagreements: Sequence[str]) -> None:
        """Refuse the session if fewer than `LEAST_FRAMES` agree.

        Parameters
        ----------
        disagreements
            Why each frame disagrees; an empty text where it agrees.

        Raises
        ------
        InputError
            Names frames that do not agree, with by how much, and what to try.
        """
        named = zip(self.frames, disagreements, strict=True)
        off = [f"{frame.name} {text.removeprefix(f'{DISAGREES}: ')}" for frame, text in named if text]
        agree = len(self.frames) - len(off)
        if agree < LEAST_FRAMES:
            more = f"; and {len(off) - _MOST_NAMED} more" if len(off) > _MOST_NAMED else ""
            raise InputError(
                f"session: expected at least {LEAST_FRAMES} frames that agree on where the arm's base is, got {agree} "
                f"of {len(self.frames)} ({'; '.join(off[:_MOST_NAMED])}{more}): {_TO_TRY}"
            )

    @property
    def agreeing(self) -> list[bool]:
        """Whether each frame agrees with the session."""
        return [not text for text in self.disagreements]

    def left_out_predictions(self) -> list[Posed]:
        """Return what all other frames predict of each frame."""
        return [self.model.subset([i]).predict(leave_one_out(self.solution, i))[0] for i in range(len(self.frames))]
