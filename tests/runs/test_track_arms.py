"""Followed arms that were exchanged, recognised by their tracks and readings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from helpers.track_rows import JOINTS, row

from dvrk_cmaes import Result
from dvrk_cmaes.runs.agreement import exchanged_arms
from dvrk_cmaes.runs.track_outputs import followed_results

COUNT = 40


def followed(joints: np.ndarray, gone: int, read: np.ndarray) -> dict[str, Result]:
    """Give the results of an arm that was followed, with joints (N, 3), rad, found in all frames but one."""
    rows = [row(k, "lost" if k == gone else "ok") for k in range(len(joints))]
    rows[gone]["status"] = "lost"
    for one, found in zip(rows, joints.tolist(), strict=True):
        if one["joints"]:
            one["joints"] = dict(zip(JOINTS, found, strict=True))
    return followed_results(cast(Any, SimpleNamespace(rows=rows, readings=readings_of(read))))


def readings_of(joints: np.ndarray) -> dict[str, np.ndarray]:
    """Give the readings (N,) of each joint, 8 deg off, of which the first are missing."""
    read = joints + np.deg2rad(8)
    read[:2] = np.nan
    return dict(zip(JOINTS, read.T, strict=True))


def test_arms_exchanged_on_the_way_are_named_with_the_frame() -> None:
    rng = np.random.default_rng(0)
    first, second = (
        at + np.cumsum(0.02 * rng.standard_normal((COUNT, 3)), axis=0) for at in ([0.6, 0.5, 0.9], [-0.5, 0.2, 0.3])
    )
    own = {"PSM1": followed(first, 7, first), "PSM2": followed(second, 20, second)}
    assert exchanged_arms(own, followed=True) == []
    exchanged = {
        "PSM1": followed(np.r_[first[:12], second[12:]], 7, first),
        "PSM2": followed(np.r_[second[:12], first[12:]], 20, second),
    }
    (text,) = exchanged_arms(exchanged, followed=True)
    assert text.endswith("seem to be exchanged from frame 0012 on")
