"""Whether tools of a session have each other's masks: frames are estimated again with the masks exchanged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.evaluate.exchanged_tools import describe_exchange, exchanged_tools, masks_exchanged
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.session_folder import Session
from dvrk_cmaes.instrument.arm import Arm
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import estimate_frame
from dvrk_cmaes.silhouette import Body

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
    """What was found of an arm in a frame: its readings, rad and m, whether it is ok, and the loss, if it is known."""

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
    return FoundFrame(result.readings, result.status == "ok", loss)


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
            texts.append(describe_exchange(first, second, "the readings of each fit the masks of the other better"))
    return texts


def _losses(
    arms: Mapping[str, ArmInSession],
    found: Mapping[str, Mapping[str, FoundFrame]],
    pair: tuple[str, str],
    name: str,
    config: EstimateConfig,
) -> tuple[float, float] | None:
    """Return the losses of two arms together in a frame with their masks, and with each other's; None without them."""
    files = {arm: next((own for own in arms[arm].session.frames if own.name == name), None) for arm in pair}
    own, exchanged = 0.0, 0.0
    for arm, other in (pair, pair[::-1]):
        mine, masks, frame = files[arm], files[other], found[arm][name]
        if mine is None or masks is None:
            return None
        mine = replace(mine, readings=frame.readings)
        known = frame.loss if frame.loss is not None else _loss(mine, arms[arm], config)
        tried = _loss(_with_masks(mine, masks), arms[arm], config)
        if known is None or tried is None:
            return None
        own, exchanged = own + known, exchanged + tried
    return own, exchanged


def _with_masks(files: FrameFiles, other: FrameFiles) -> FrameFiles:
    """Return the files of a frame with the masks of another tool, in all views."""
    views = {view: _with_masks(each, other.others[view]) for view, each in files.others.items()}
    return replace(files, mask=other.mask, label=other.label, other_tools=other.other_tools, others=views)


def _loss(files: FrameFiles, arm: ArmInSession, config: EstimateConfig) -> float | None:
    """Estimate a frame and return its loss; None without a pose."""
    try:
        data = read_frame(files, arm.session.rig)
        result = estimate_frame(files, data, arm.body, arm=arm.kinematics, config=config)
    except DvrkCmaesError:
        return None
    return None if result.quality is None else result.quality.loss
