"""Which mask is whose, where several arms are followed: the bases tell, by where they expect each tool in a frame.

Masks may be named by the wrong arm in all frames or in some. Readings and base of an arm tell where its tool is; where
two tools are each expected at the mask of the other one, each is followed by that mask.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import Any, Final

import numpy as np

from dvrk_cmaes.calibration.calibrate import in_threads
from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.calibration.endoscope import Place
from dvrk_cmaes.calibration.session_state import SessionProblem
from dvrk_cmaes.calibration.together import Solving, solved_together
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.packed_mask import overlap_of
from dvrk_cmaes.geometry import Bool, Float64, Posed
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.pose.views import silhouette_of
from dvrk_cmaes.runs.exchanged_tools import ArmInSession, with_masks_of
from dvrk_cmaes.runs.recorded import BLOCK, RecordedSolution, predict
from dvrk_cmaes.runs.recorded_keyframes import RecordedFrames, read_shown, solving_keyframes
from dvrk_cmaes.silhouette import Body

_CLEAR: Final = 0.25  # of intersection over union, by which each tool must be expected at the other's mask
_AGREE: Final = 0.5  # share of the keyframes that agree, below which each other's masks are tried
_MORE: Final = 1.5  # times as large a share must agree with these


class ArmsOfRecording:
    """The arms of a recording that are followed, and what their bases tell of the masks.

    Parameters
    ----------
    arms
        The session as each arm sees it, by arm.
    """

    def __init__(self, arms: Mapping[str, ArmInSession]) -> None:
        self.arms = arms
        self.files = {name: {own.name: own for own in arm.session.frames} for name, arm in arms.items()}
        self.centres: dict[str, dict[str, Float64]] = {}
        """Those of the masks, px, by arm and frame."""
        self.gains: dict[tuple[str, str], dict[str, float]] = {}
        """By how much more an arm's tool overlaps the mask of another arm, by frame."""

    def as_followed(self, frames: Sequence[FrameFiles], rows: Sequence[Mapping[str, Any]]) -> tuple[FrameFiles, ...]:
        """Return frames with the masks by which they were followed, as their rows of tracks.jsonl tell."""
        found = []
        for files, row in zip(frames, rows, strict=True):
            other = next((name for name in self.arms if _taken_from(name) in row["remarks"]), None)
            found.append(files if other is None else with_masks_of(self.files[other][files.name], files))
        return tuple(found)


@dataclass(frozen=True, eq=False)
class AmongArms:
    """An arm that is followed beside others; ``places`` are those at which another one found the endoscope."""

    arm: str = ""
    of: ArmsOfRecording = field(default_factory=lambda: ArmsOfRecording({}))
    places: Sequence[Place] = ()

    def solving(self, recorded: RecordedFrames, work: SessionProblem) -> Solving[SessionCalibration | str]:
        """Solve the keyframes as `solving_keyframes`; with another arm's masks if few agree, and more with those."""
        found = yield from solving_keyframes(recorded, work, self.places)
        for other in self._others(recorded) if _agreeing(found) < _AGREE else ():
            work.progress(f"trying the masks of {other}", len(recorded.files))
            exchanged = self._with_masks(other, recorded, np.ones(len(recorded.files), np.bool_))
            tried = yield from solving_keyframes(exchanged, work, self.places)
            if _agreeing(tried) > _MORE * _agreeing(found):
                found = tried
        return found

    def decided(self, solution: RecordedSolution, work: SessionProblem) -> Solving[RecordedSolution]:
        """Return the recording with the masks at which its base, and those of the others, expect the tools.

        Remarks say which masks were taken from another arm.
        """
        for other, taken in (yield from self.exchanged(solution, work)).items():
            if taken.any():
                names = [own.name for own in solution.recorded.files]
                exchanged = np.array(names)[taken].tolist()
                remark = (
                    f"{describe_exchanged('this arm', other, exchanged, names)}: each is followed by that of the other"
                )
                calibration = replace(solution.calibration, remarks=(*solution.calibration.remarks, remark))
                changed = self._with_masks(other, solution.recorded, taken)
                texts = dict.fromkeys(exchanged, _taken_from(other))
                solution = replace(solution, recorded=changed, calibration=calibration, remarks=texts)
        return solution

    def exchanged(self, solution: RecordedSolution, work: SessionProblem) -> Solving[dict[str, Bool]]:
        """Return by other arm in which frames (N,) that one and this arm have each other's masks."""
        recorded, names = solution.recorded, [own.name for own in solution.recorded.files]
        self.of.centres[self.arm] = dict(zip(names, recorded.centres, strict=True))
        yield None
        others = [other for other in self._others(recorded) if other in self.of.centres]
        predicted = predict(recorded, solution.calibration, work.instrument.joint_names)[0].at if others else None
        for other in others:
            assert predicted is not None
            self.of.gains[self.arm, other] = self._gained(other, recorded, predicted, work)
        yield None
        return {other: self._taken(other, names) for other in others}

    def _taken(self, other: str, names: Sequence[str]) -> Bool:
        """Return in which of N frames (N,) an arm takes the masks of another one.

        It does where both tools are clearly expected at each other's masks, and not where both are nearer to their own;
        in all other frames, as where tools cross, as in the nearest frame that tells.
        """
        gains = [self.of.gains.get(pair, {}) for pair in ((self.arm, other), (other, self.arm))]
        told = np.zeros(len(names), np.intp)
        for i, name in enumerate(names):
            of_both = [own[name] for own in gains if name in own]
            told[i] = -1 if not of_both else len(of_both) == 2 and min(of_both) > _CLEAR
        known = np.flatnonzero(told)
        if not (told > 0).any():
            return np.zeros(len(names), np.bool_)
        nearest = known[np.abs(np.arange(len(names))[:, None] - known).argmin(axis=1)]
        return np.asarray(told[nearest] > 0)

    def _others(self, recorded: RecordedFrames) -> list[str]:
        """Return the other arms that have all frames of a recording."""
        names = {own.name for own in recorded.files}
        return [other for other, files in self.of.files.items() if other != self.arm and names <= files.keys()]

    def _with_masks(self, other: str, recorded: RecordedFrames, taken: Bool) -> RecordedFrames:
        """Return an arm's recording with the masks of another arm in the frames (N,) in which these are taken."""
        files = tuple(
            with_masks_of(self.of.files[other][own.name], own) if exchanged else own
            for own, exchanged in zip(recorded.files, taken.tolist(), strict=True)
        )
        return RecordedFrames.of(files, recorded.rig, recorded.series, recorded.times)

    def _gained(self, other: str, recorded: RecordedFrames, predicted: Posed, work: SessionProblem) -> dict[str, float]:
        """Return by how much more a tool is expected to overlap the other's mask, in frames in which that is nearer."""
        tasks = []
        for first in range(0, len(recorded.files), BLOCK):
            frames = []
            for i, own in enumerate(recorded.files[first : first + BLOCK], start=first):
                masks = own, with_masks_of(self.of.files[other][own.name], own)
                centres = np.array([self.of.centres[name][own.name] for name in (self.arm, other)])
                frames.append(ExpectedFrame(own.name, masks, recorded.rig, centres, predicted[i]))
            tasks.append(tuple(frames))
        return {name: gain for block in work.run(gains_task, tasks) for name, gain in block.items()}


@dataclass(frozen=True, eq=False)
class ExpectedFrame:
    """A frame, its masks and those of another tool, their centres (2, 2), px, and where its own tool is expected."""

    name: str
    masks: tuple[FrameFiles, FrameFiles]
    rig: Rig
    centres: Float64
    at: Posed

    def gain(self, body: Body) -> float | None:
        """Return by how much more the silhouette overlaps the other mask than its own; None where its own is nearer."""
        view = self.rig.views[0]
        shown = silhouette_of(self.at, view, body)
        if shown.any() and not np.isnan(self.centres).any():
            rows, columns = np.nonzero(shown)
            own, other = np.linalg.norm(self.centres - [columns.mean(), rows.mean()], axis=1)
            if own <= other:
                return None
        seen = (self._mask(read_shown(files, self.rig), shown) for files in self.masks)
        mine, others = (overlap_of(shown, mask) for mask in seen)
        return others - mine

    @staticmethod
    def _mask(data: FrameData | None, shown: Bool) -> Bool:
        """Return the mask of the reference view; empty where it has none, or another size."""
        mask = None if data is None else data.mask
        return np.zeros_like(shown) if mask is None or mask.shape != shown.shape else mask


def gains_task(body: Body, config: EstimateConfig, frames: Sequence[ExpectedFrame]) -> dict[str, float]:
    """Return what each of some frames gains by the mask of another tool, where that may be, by name."""
    return {frame.name: gain for frame in frames if (gain := frame.gain(body)) is not None}


def exchanged_frames(
    arms: Mapping[str, ArmInSession], calibrations: Mapping[str, SessionCalibration], config: EstimateConfig
) -> list[str]:
    """Say in which frames of a calibrated session two arms have each other's masks; empty without any.

    ``arms`` and ``calibrations`` are by arm. Errors as of `read_frame`.
    """
    of = ArmsOfRecording(arms)

    def telling(name: str, _: Sequence[Place]) -> Solving[dict[str, Bool]]:
        session, body = arms[name].session, arms[name].body
        times = np.arange(len(session.frames), dtype=np.float64)
        recorded = RecordedFrames.of(session.frames, session.rig, session.reading_series(), times)
        run = partial(in_threads, body, config)
        work = SessionProblem(recorded.series, body.instrument, arms[name].kinematics, config, run)
        return AmongArms(name, of).exchanged(RecordedSolution(recorded, calibrations[name]), work)

    found = solved_together({name: partial(telling, name) for name in arms})
    texts = []
    for first, second in combinations(arms, 2):
        names = [own.name for own in arms[first].session.frames]
        exchanged = np.array(names)[found[first].get(second, np.zeros(len(names), np.bool_))].tolist()
        if exchanged:
            texts.append(f"{describe_exchanged(first, second, exchanged, names)}: exchange their labels or files there")
    return texts


def _taken_from(other: str) -> str:
    """Return the remark of a frame that is followed by the mask of another arm."""
    return f"mask named as that of {other}, where the base expects this tool"


def describe_exchanged(first: str, second: str, exchanged: Sequence[str], names: Sequence[str]) -> str:
    """Say in which of a recording's frames two arms have each other's masks."""
    return (
        f"the masks of {first} and {second} are exchanged in {len(exchanged)} of {len(names)} frames "
        f"({listed(exchanged)}), as their bases tell"
    )


def _agreeing(found: SessionCalibration | str) -> float:
    """Return the share of the keyframes that agree with a calibration; zero without one."""
    if isinstance(found, str):
        return 0.0
    return len(found.frames) / max(len(found.frames) + len(found.left_out), 1)
