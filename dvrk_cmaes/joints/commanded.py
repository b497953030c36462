"""Joints whose readings never move while the arm does: values that were commanded, or not recorded, and not measured.

Such a reading has less information on its joint than a measured one: its standard deviation is larger.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Final

import numpy as np

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.joints.names import OUTER_JOINTS

_LEAST_FRAMES: Final = 5  # in which a joint has the same reading
_SAME: Final = 1e-9  # rad
_MOVES: Final = 0.01  # rad or m, by which an outer joint moves at least
_WIDER: Final = 2.0
"""Factor on the standard deviations of commanded joints, that of their readings and that from frame to frame."""


def commanded_joints(outer: Float64, joints: Float64, names: Sequence[str]) -> list[str]:
    """Return the joints whose readings (N, J) never change while those of the outer joints (N, 4) do; NaN for none."""
    known = outer[~np.isnan(outer).any(axis=1)]
    moving = len(known) > 0 and np.ptp(known, axis=0).max() > _MOVES
    out = []
    for name, values in zip(names, joints.T, strict=True):
        read = values[~np.isnan(values)]
        if moving and len(read) >= _LEAST_FRAMES and np.ptp(read) < _SAME:
            out.append(name)
    return out


def commanded_in(readings: Sequence[Mapping[str, float]], names: Sequence[str]) -> list[str]:
    """Return the commanded ones among some joints, as `commanded_joints`, given the readings of frames by joint."""
    outer, joints = (
        np.array([[own.get(name, np.nan) for name in wanted] for own in readings]).reshape(len(readings), len(wanted))
        for wanted in (OUTER_JOINTS, names)
    )
    return commanded_joints(outer, joints, names)


def describe_commanded(commanded: Sequence[str]) -> str:
    """Return the warning that the readings of some joints, at least one, never move."""
    part = "jaw" if list(commanded) == ["jaw"] else "wrist"
    joints = " and ".join(filter(None, [", ".join(commanded[:-1]), commanded[-1]]))
    return (
        f"{part} readings never move: {joints} constant while the arm moves; taken for commanded values, with "
        f"{_WIDER:g} times the usual standard deviation"
    )


def with_commanded(config: EstimateConfig, commanded: Collection[str], names: Sequence[str]) -> EstimateConfig:
    """Return settings for a session in which some of an instrument's joints ``names`` are commanded.

    Standard deviations that are not the default ones are kept. The wrist's joints share one from frame to frame, which
    is wider where all of them are commanded.
    """
    wrist = [name for name in names if name != "jaw"]
    own = {field.name for field in fields(config.readings)}
    readings = [f"{name}_deg" if f"{name}_deg" in own else "other_deg" for name in commanded]
    session = ["jaw_deg"] if "jaw" in commanded else []
    session += ["wrist_deg"] if wrist and set(wrist) <= set(commanded) else []
    return replace(config, readings=_widened(config.readings, readings), session=_widened(config.session, session))


def _widened(settings: Any, names: Collection[str]) -> Any:
    """Return a table of settings with some standard deviations widened, where they are the default ones."""
    usual = vars(type(settings)())
    wide = {name: _WIDER * usual[name] for name in names if getattr(settings, name) == usual[name]}
    return replace(settings, **wide)
