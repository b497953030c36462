"""The state of a session while it is solved: what each arm is estimated with, its frames, and how far they are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.blocks import BlockCheck, Calibration, FoundBlock, SeenBlock, TestedBlock
from dvrk_cmaes.calibration.cables import CableFit
from dvrk_cmaes.calibration.consensus import ArmModes
from dvrk_cmaes.calibration.frame_fit import FrameFit
from dvrk_cmaes.calibration.lag import SessionLag
from dvrk_cmaes.calibration.masks_and_sizes import MaskMargin, PartSizes, WholeSize, taken_off
from dvrk_cmaes.calibration.model import SessionModel, frames_alike
from dvrk_cmaes.calibration.session_camera import CameraChange, Lens
from dvrk_cmaes.calibration.session_frame import Run, SeenAs, SessionFrame, StoredFrame
from dvrk_cmaes.calibration.solve import ArmFrames, FrameFits, Solved
from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64, Indices, Posed
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.pose.doubts import DISAGREES, frame_disagrees
from dvrk_cmaes.pose.terms.term import Quadratic

LEAST_FRAMES = 3
"""Smallest number of frames from which an arm can be calibrated."""

_MOST_NAMED = 4
_TO_TRY = "try another --instrument, --tool or --arm, other readings, or the lag of all rows of the recording"


TESTED: Final[tuple[Callable[[EstimateConfig, Camera], TestedBlock], ...]] = (PartSizes, WholeSize, Lens)
"""What makes the tested blocks besides camera and margin, by settings and the camera of the outlines."""


@dataclass(frozen=True, eq=False)
class ArmSetup:
    """What an arm's session is estimated with, besides its frames.

    ``series`` are the readings as functions of time, with the frames' times; None if the lag is not to be estimated.
    ``instrument``, ``arm`` and ``config`` are the instrument, the kinematics of the outer arm and all settings. ``run``
    applies a function to many tasks, ``progress`` is called before each stage with its name and the number of frames.
    ``refine_camera`` is whether the change of the camera that the frames fit is used, ``guessed_camera`` whether the
    frames' camera is a guess, of which there is no file. ``lag`` is the one that is taken out of the readings, None to
    look for it.
    """

    series: ReadingSeries | None
    instrument: Instrument
    arm: Arm
    config: EstimateConfig
    run: Run[Any, Any]
    progress: Callable[[str, int], None] = lambda stage, count: None
    refine_camera: bool = False
    guessed_camera: bool = False
    lag: Lag | None = None


@dataclass(frozen=True, eq=False)
class ArmSession(ArmModes):
    """The frames of one arm in a session, and how far its estimation is.

    ``frames`` are the N frames in use, and ``model`` is the model of their readings, with what the lag takes out of
    these; ``cables`` are the fits of what cables do to readings, None before the first. ``stored`` is
    the frames' evidence and ``fits`` are their current fits, both empty before the first round. ``found`` is the
    current solution, None before the first one; ``moved`` (N) are the poses from which the next fits start, where
    blocks that are tested were estimated since, and ``seen`` the values of these where they are not those in use;
    ``last`` is whether the fits are those of the last round.

    ``change`` (3,) is that of the camera, as of `session_frame.changed`, None where the camera's file is used; ``rig``
    what the further views differ in from the file; ``margin`` states that of the masks, ``check`` what is found of all
    blocks that are seen, None until they are known.

    ``remarks`` are about faults of the session as a whole that are put right, ``undetermined`` about what it does not
    determine; ``left_out`` are the reasons for which frames are left out, by name.
    """

    setup: ArmSetup
    frames: tuple[SessionFrame, ...]
    lag: SessionLag
    rig: Mapping[str, FoundBlock] = field(default_factory=dict)
    change: Float64 | None = None
    margin: FoundBlock | None = None
    check: BlockCheck | None = None
    cables: tuple[CableFit, CableFit] | None = None
    stored: tuple[StoredFrame, ...] = ()
    fits: tuple[FrameFit, ...] = ()
    found: Solved | None = None
    moved: Posed | None = None
    seen: Mapping[str, Float64] = field(default_factory=dict)
    last: bool = False
    remarks: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, setup: ArmSetup, frames: Sequence[SessionFrame], rig: Mapping[str, FoundBlock] | None = None
    ) -> ArmSession:
        """Return an arm before anything is estimated.

        Parameters
        ----------
        setup
            What the arm's session is estimated with.
        frames
            Frames with a pose, its covariance and readings of all outer joints, in the order they were taken.
        rig
            The rotations of the further views against the file that the frames' own results show; those that are clear
            are taken out of the frames.
        """
        readings = [frame.result.readings for frame in frames]
        model = SessionModel.of(readings, setup.instrument, setup.config, setup.arm)
        read, alike = [frame.name for frame in frames], setup.config.session.alike_seconds
        lag = SessionLag.of(setup.series, read, model.deviations[:4], setup.lag, alike)
        modes = vars(ArmModes.of_results(model, [frame.result for frame in frames]))
        change = np.zeros(3) if setup.refine_camera else None
        return cls(**modes, setup=setup, frames=tuple(frames), lag=lag, rig=rig or {}, change=change)

    @property
    def solution(self) -> Solved:
        """The current solution."""
        assert self.found is not None
        return self.found

    @property
    def calibration(self) -> Calibration:
        """The current calibration."""
        return self.solution.calibration

    @property
    def at(self) -> Posed:
        """The current poses (N) of the frames."""
        return Posed.stacked(fit.at for fit in self.fits) if self.moved is None else self.moved

    def with_solution(self, found: Solved, **changes: Any) -> ArmSession:
        """Return the arm with a solution and its model, and other changes."""
        return replace(self, model=found.model, found=found, **changes)

    def with_calibration(self, calibration: Calibration, **changes: Any) -> ArmSession:
        """Return the arm with another calibration, and other changes."""
        return replace(self, found=replace(self.solution, calibration=calibration), **changes)

    def subset(self, index: Sequence[int] | Indices) -> ArmSession:
        """Return the arm with the frames at some indices, and their fits, before the next solution."""
        stored, fits = (
            tuple(self.stored[i] for i in index if self.stored),
            tuple(self.fits[i] for i in index if self.fits),
        )
        frames, lag = tuple(self.frames[i] for i in index), self.lag.subset(index)
        return replace(super().subset(index), frames=frames, stored=stored, fits=fits, lag=lag)

    def noted(self, *, remarks: Sequence[str] = (), undetermined: Sequence[str] = ()) -> ArmSession:
        """Return the arm with further texts."""
        return replace(self, remarks=(*self.remarks, *remarks), undetermined=(*self.undetermined, *undetermined))

    @property
    def stated_settings(self) -> dict[str, Any]:
        """The settings as results state them, with the limits of the instrument's joints."""
        return {**self.setup.config.as_dict(), "instrument": self.setup.instrument.describe_limits(self.setup.arm)}

    @property
    def checked(self) -> BlockCheck:
        """What is found of the blocks that are seen."""
        assert self.check is not None
        return self.check

    def outlines(self, *, tested: bool = False, keep_all: bool = False) -> ArmFrames:
        """Return the current fits; without the outlines that do not explain the mask, unless ``keep_all``.

        As functions of the ``tested`` blocks, too, they are those of one view; a frame without it does not count.
        """
        seen = {block.name: value for block, value in self.seen_as} if tested else {}
        none = Quadratic.zero(1, 6 + self.at.joints.shape[1] + sum(len(value) for value in seen.values()))
        counts = np.array([fit.explains_mask or keep_all for fit in self.fits], np.float64)
        terms = Quadratic.joined([(fit.seen or none) if tested else fit.alone for fit in self.fits]).times(counts)
        # others without an outline do not count
        when = np.where(terms.information.any(axis=(1, 2)), self.lag.seconds(), np.nan)
        shares = 1 / frames_alike(when, self.setup.config.session.alike_seconds)
        by_lag = self.lag.change_of_predictions(self.model, self.calibration)
        whole = self.calibration.alone().with_blocks(*self.tested, **self.seen) if tested else self.calibration
        return ArmFrames(self.model, FrameFits(self.at, terms, shares, by_lag, seen), whole)

    @property
    def shown(self) -> list[int | None]:
        """Number of the one view in which each frame's outline shows the blocks; None where it does not.

        The view is that of the reference camera; another one if that does not show the instrument in any frame.
        """
        first = [stored.views[0] for stored in self.stored]  # that of the reference camera, where it shows it
        name = next((view.name for view in first if np.array_equal(view.view_from_camera, np.eye(4))), first[0].name)
        return [next((k for k, one in enumerate(own.views) if one.name == name), None) for own in self.stored]

    @property
    def camera(self) -> Camera:
        """The camera of the first frame in that view, as its file has it."""
        return self.stored[0].views[self.shown[0] or 0].evidence.camera

    @property
    def tested(self) -> tuple[TestedBlock, ...]:
        """The blocks that are tested, which begin with the values in use: the margin, and the camera if it is changed.

        With a camera that is changed, those of its lens are tested, too; all others from the last round on.
        """
        config, camera = self.setup.config, self.camera
        change, start = self.change, taken_off(self.margin)
        margin = MaskMargin(camera.pixel_scale, start, used=change is None)
        makes = TESTED if self.last else (Lens,)
        others = (CameraChange(config, camera, change), *(make(config, camera) for make in makes))
        return margin, *(others if self.last or change is not None else ())

    @property
    def seen_as(self) -> SeenAs:
        """The tested blocks that change what the views show, with their values in the fits."""
        blocks = [block for block in self.tested if isinstance(block, SeenBlock)]
        return tuple((one, one.start if one.is_linear else self.seen.get(one.name, one.start)) for one in blocks)

    @property
    def disagreements(self) -> list[str]:
        """Why each frame disagrees with the calibration; an empty text where it agrees."""
        pairs = zip(self.fits, self.solution.misfit.tolist(), strict=True)
        return [self._disagreement(fit, misfit) for fit, misfit in pairs]

    @property
    def agreeing(self) -> int:
        """Number of frames that agree with the session."""
        return self.disagreements.count("")

    def _disagreement(self, fit: FrameFit, misfit: float = 0.0) -> str:
        """Say why a fit disagrees, whose squared distance from what is expected, per parameter, is ``misfit``."""
        most = self.setup.config.session.largest_misfit
        return frame_disagrees(misfit, most, None if fit.explains_mask else (fit.iou, fit.own_iou)) or ""

    def check_agreement(self, disagreements: Sequence[str] | None = None) -> None:
        """Refuse an arm of which fewer than `LEAST_FRAMES` agree, by default as to whether fits explain their masks.

        Parameters
        ----------
        disagreements
            Why each frame disagrees; an empty text where it agrees.

        Raises
        ------
        InputError
            Names frames that do not agree, with by how much, and what to try.
        """
        texts = [self._disagreement(fit) for fit in self.fits] if disagreements is None else disagreements
        named = zip(self.frames, texts, strict=True)
        off = [f"{frame.name} {text.removeprefix(f'{DISAGREES}: ')}" for frame, text in named if text]
        agree = len(self.frames) - len(off)
        if agree < LEAST_FRAMES:
            more = f"; and {len(off) - _MOST_NAMED} more" if len(off) > _MOST_NAMED else ""
            raise InputError(
                f"session: expected at least {LEAST_FRAMES} frames that agree on where the arm's base is, got {agree} "
                f"of {len(self.frames)} ({'; '.join(off[:_MOST_NAMED])}{more}): {_TO_TRY}"
            )

    def camera_refused(self, reason: str) -> InputError:
        """Return the refusal to find the camera of a session that does not determine it."""
        if self.setup.guessed_camera:
            needed = "--camera: expected a camera file, which these frames do not replace"
            return InputError(f"{needed}: {reason} (dvrk-cmaes help uncalibrated)")
        return InputError(f"--refine-camera: {reason}")


Arms = list[ArmSession]
"""The arms of a session."""
