"""Two tools of a session whose masks or readings were exchanged.

Either the joints found for each are nearer to the readings of the other, or frames that are estimated again with the
masks exchanged fit better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.silhouette import Body

_LEAST_FRAMES: Final = 3
_FACTOR: Final = 2.0  # of the squared distances from the own readings and from those of the other tool
_JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw")
_LEAST_BETTER: Final = 0.75  # share of the frames in which the other's masks fit better
_LARGEST_RATIO: Final = 0.85  # of the loss with the other's masks to that with the own ones, median
_LEAST_FOLLOWED: Final = 15  # frames at the end of a recording
_LEAST_OFF: Final = np.deg2rad(30)  # from the own readings there, of both tools together; more than cables explain
_TRIED: Final = 4  # frames of two arms
_SUSPECT: Final = 0.5  # share of the frames of two arms that are not ok, from which on they are tried


@dataclass(frozen=True, eq=False)
class ArmInSession:
    """An arm of a session: the session as it sees it, its instrument and its kinematics."""

    session: Session
    body: Body
    kinematics: Arm


@dataclass(frozen=True)
class FoundFrame:
    """What was found of an arm in a frame: its joints, rad, and readings, rad and m, whether it is ok, and the loss.

    There are no joints without a pose; the loss may not be known.
    """

    joints: Mapping[str, float]
    readings: Mapping[str, float]
    ok: bool
    loss: float | None = None


def exchanged_in_results(
    arms: Mapping[str, ArmInSession], results: Mapping[str, Mapping[str, Result]], config: EstimateConfig
) -> list[str]:
    """Say which arms seem to be exchanged, given the results of each by frame: by their joints, else by their masks."""
    return exchanged_tools(results) or find_exchanged_masks(
        arms,
        {arm: {name: _found(result) for name, result in of_arm.items()} for arm, of_arm in results.items()},
        config,
    )


def _found(result: Result) -> FoundFrame:
    """Return what a result says; a loss with a session's calibration, or with tools behind, is not comparable."""
    other = result.source == "session" or "behind" in result.other_tools.values()
    loss = None if result.quality is None or other else result.quality.loss
    return FoundFrame(result.joints, result.readings, result.status == "ok", loss)


def find_exchanged_masks(
    arms: Mapping[str, ArmInSession], found: Mapping[str, Mapping[str, FoundFrame]], config: EstimateConfig
) -> list[str]:
    """Say which arms seem to have each other's masks, given what was found of each by frame; empty without any.

    Four frames of two arms, of which half or more are not ok, are estimated with the masks of the other arm, and with
    the own masks where the loss is not known. Frames that cannot be read or estimated are left out.
    """
    texts = []
    for first, second in combinations(arms, 2):
        names = [name for name, frame in found[first].items() if name in found[second] and frame.readings]
        bad = [not found[arm][name].ok for arm in (first, second) for name in names]
        if not names or np.mean(bad) < _SUSPECT:
            continue
        chosen = sorted({*np.linspace(0, len(names) - 1, _TRIED).astype(int).tolist()})
        losses = [_losses(arms, found, (first, second), names[k], config) for k in chosen]
        if masks_exchanged([pair for pair in losses if pair is not None]):
            texts.append(_describe(first, second, "the readings of each fit the masks of the other better"))
    return texts


def masks_exchanged(losses: Sequence[tuple[float, float]]) -> bool:
    """Whether two tools have each other's masks, given the losses of frames with their masks and with the other's.

    A loss of a frame is the sum of those of both tools. Joints alone do not tell it: wrong readings pull a pose so much
    that it stays nearer to them than to those of the other tool.
    """
    if len(losses) < _LEAST_FRAMES:
        return False
    ratios = np.array([exchanged / own for own, exchanged in losses])
    return bool(np.mean(ratios < 1) >= _LEAST_BETTER and np.median(ratios) < _LARGEST_RATIO)


def _losses(
    arms: Mapping[str, ArmInSession],
    found: Mapping[str, Mapping[str, FoundFrame]],
    pair: tuple[str, str],
    name: str,
    config: EstimateConfig,
) -> tuple[float, float] | None:
    """Return the losses of two arms together in a frame with their masks, and with each other's; None without them."""
    files = {arm: next((frame for frame in arms[arm].session.frames if frame.name == name), None) for arm in pair}
    own, exchanged = 0.0, 0.0
    for arm, other in (pair, pair[::-1]):
        mine, masks, frame = files[arm], files[other], found[arm][name]
        if mine is None or masks is None:
            return None
        mine = replace(mine, readings=frame.readings)
        known = frame.loss if frame.loss is not None else _loss(mine, arms[arm], config)
        tried = _loss(with_masks_of(masks, mine), arms[arm], config)
        if known is None or tried is None:
            return None
        own, exchanged = own + known, exchanged + tried
    return own, exchanged


def with_masks_of(other: FrameFiles, files: FrameFiles) -> FrameFiles:
    """Return the files of a frame with the masks of another tool, in all views."""
    views = {view: with_masks_of(other.others[view], each) for view, each in files.others.items()}
    return replace(files, mask=other.mask, label=other.label, other_tools=other.other_tools, others=views)


def _loss(files: FrameFiles, arm: ArmInSession, config: EstimateConfig) -> float | None:
    """Estimate a frame and return its loss; None without a pose."""
    try:
        data = read_frame(files, arm.session.rig)
        result = estimate_frame(files, data, arm.body, FrameMethod(arm.kinematics, config))
    except DvrkCmaesError:
        return None
    return None if result.quality is None else result.quality.loss


def exchanged_tools(found: Mapping[str, Mapping[str, Result | FoundFrame]], *, followed: bool = False) -> list[str]:
    """Say which tools seem to be exchanged, given what was found of each arm by frame; empty without any.

    Two tools are compared in the frames in which both were found and read. The readings pull a pose towards them, so
    joints that are clearly nearer to the readings of the other tool are no accident. Tools that are ``followed``, whose
    frames are in order, may be exchanged from a frame on to the end: that from which on the distances from the own
    readings exceed the others' most.
    """
    least, least_off = (_LEAST_FOLLOWED, _LEAST_OFF**2) if followed else (_LEAST_FRAMES, 0.0)
    texts = []
    for first, second in combinations(found, 2):
        distances = _distances(found[first], found[second])
        if len(distances) < least:
            continue
        values, start = np.array(list(distances.values())), 0
        if followed:
            excess = np.cumsum((values[:, 0] - values[:, 1])[::-1])[::-1]
            start = int(np.argmax(excess[: len(values) - least + 1]))
        own, other = np.median(values[start:], axis=0)
        if own > _FACTOR * other and own > least_off:
            degrees = f"{np.degrees(np.sqrt(other)):.0f} instead of {np.degrees(np.sqrt(own)):.0f} deg"
            nearer = f"the joints found for each are nearer to the readings of the other ({degrees})"
            since = f" from frame {list(distances)[start]} on" if followed else ""
            texts.append(_describe(first, second, nearer) + since)
    return texts


def _distances(
    first: Mapping[str, Result | FoundFrame], second: Mapping[str, Result | FoundFrame]
) -> dict[str, tuple[float, float]]:
    """Return the squared distances of two tools' joints from the own and the other's readings, rad^2, by frame.

    Of frames in which both were found and read.
    """
    return {
        name: (
            _distance(a.joints, a.readings) + _distance(b.joints, b.readings),
            _distance(a.joints, b.readings) + _distance(b.joints, a.readings),
        )
        for name, a in first.items()
        if (b := second.get(name)) is not None and all((a.joints, a.readings, b.joints, b.readings))
    }


def _distance(found: Mapping[str, float], read: Mapping[str, float]) -> float:
    """Return the summed squares of the distances of found joints from readings, rad^2."""
    names = [name for name in _JOINTS if name in found and name in read]
    return float(sum((found[name] - read[name]) ** 2 for name in names))


def _describe(first: str, second: str, evidence: str) -> str:
    """Say that two tools seem to be exchanged, and why."""
    return f"{first} and {second}: {evidence}; their masks or readings seem to be exchanged"
