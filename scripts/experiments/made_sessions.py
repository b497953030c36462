"""Synthetic sessions in memory, and the results of each method for their frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.estimation.pnp.frame import pose_from_markers, pose_from_tips
from dvrk_cmaes.evaluate.pose_error import PoseError, compare_poses
from dvrk_cmaes.evaluate.result_set import ResultSet
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.markers import read_marker_table
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.synth.levels import LEVELS, LevelName
from dvrk_cmaes.synth.session import Motion, SessionPlan, SyntheticFrame, default_camera, make_frames, make_truths
from experiments.parts import progress

OURS: Final = "ours"
PNP: Final = "PnP, SQPNP"
PNP_RANSAC: Final = "PnP, RANSAC"
PNP_TIPS: Final = "tips and shaft edges"


@dataclass(frozen=True, eq=False)
class Made:
    """A synthetic session in memory; ``camera_from_base`` (4, 4) is the true one, None for independent poses."""

    plan: SessionPlan
    camera_from_base: NDArray[np.float64] | None
    frames: tuple[SyntheticFrame, ...]


def make(body: Body, level: LevelName, frames: int, seed: int, motion: Motion = "rcm") -> Made:
    """Make the session that ``dvrk-cmaes synth`` writes for the same level, motion, number of frames and seed."""
    figures = LEVELS[level]
    table = read_marker_table(bundled_path("markers", "lnd.json"))
    plan = SessionPlan(body, default_camera(figures), figures, motion, frames, seed, table)
    camera_from_base, truths = make_truths(plan)
    return Made(plan, camera_from_base, tuple(make_frames(plan, truths)))


def by_estimate(made: Made, frame: SyntheticFrame, config: EstimateConfig) -> Result:
    """Estimate a frame by our method, from mask and readings."""
    return estimate(
        frame.mask,
        made.plan.camera,
        frame.readings,
        made.plan.body,
        ignore=frame.ignore,
        frame=frame.name,
        config=config,
    )


def by_points(made: Made, frame: SyntheticFrame, method: str) -> Result:
    """Estimate a frame by a PnP method, from detected markers or from jaw tips and shaft edges."""
    files = FrameFiles(frame.name, None, readings=frame.readings, keypoints=frame.tips)
    plan = made.plan
    if method == PNP_TIPS:
        data = replace(FrameData.of(frame.mask, plan.camera, frame.ignore), files=files)
        return pose_from_tips(data, plan.body.instrument)
    return pose_from_markers(
        files,
        plan.camera,
        plan.body.instrument,
        plan.markers,
        frame.markers,
        solver="ransac" if method == PNP_RANSAC else "sqpnp",
    )


def results_by(
    method: str, sessions: Sequence[Made], config: EstimateConfig, label: str = ""
) -> list[dict[str, Result]]:
    """Estimate all frames of sessions by a method; return the results of each session by frame."""
    solve: Callable[[Made, SyntheticFrame], Result] = (
        (lambda made, frame: by_estimate(made, frame, config))
        if method == OURS
        else (lambda made, frame: by_points(made, frame, method))
    )
    total, done, found = sum(len(made.frames) for made in sessions), 0, []
    for made in sessions:
        results = {}
        for frame in made.frames:
            results[frame.name] = solve(made, frame)
            done += 1
            progress(label or method, done, total)
        found.append(results)
    return found


def result_set(name: str, made: Made, results: Mapping[str, Result]) -> ResultSet:
    """Return the poses of one session as input of the measures of agreement."""
    posed = {n: r.camera_from_root for n, r in results.items() if r.camera_from_root is not None}
    return ResultSet(
        name=name,
        frames=tuple(posed),
        camera_from_root=np.stack(list(posed.values())) if posed else np.empty((0, 4, 4)),
        readings={frame.name: frame.readings for frame in made.frames},
        failed=tuple(n for n in results if n not in posed),
    )


def error_of(frame: SyntheticFrame, result: Result) -> PoseError | None:
    """Return the error of a result; None without a pose."""
    if result.camera_from_root is None:
        return None
    truth = frame.truth
    return compare_poses(
        truth.instrument, (result.camera_from_root, result.joints), (truth.camera_from_root, truth.joints)
    )


def errors_of(sessions: Sequence[Made], results: Sequence[Mapping[str, Result]]) -> list[PoseError | None]:
    """Return the errors of all results, session by session."""
    pairs = zip(sessions, results, strict=True)
    return [error_of(frame, found[frame.name]) for made, found in pairs for frame in made.frames]
