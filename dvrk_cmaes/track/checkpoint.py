"""State of a tracker as plain values, from which another tracker goes on with the same results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.track.hypothesis import Hypothesis
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.outline_model import OutlineModel
from dvrk_cmaes.track.state import FilterState


def plain_hypothesis(one: Hypothesis) -> dict[str, Any]:
    """Return a hypothesis as plain values; their text in JSON has all digits."""
    drawn = None if one.rim is None else [one.rim.pose.tolist(), one.rim.joints.tolist()]
    return {**_plain(one), "state": _plain(one.state), "anchor": _plain(one.anchor), "rim": drawn}


def _plain(part: object) -> dict[str, Any]:
    """Return the fields of a dataclass, arrays as lists."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}  # type: ignore[arg-type]
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def read_hypothesis(values: Mapping[str, Any], model: OutlineModel) -> Hypothesis:
    """Return the hypothesis of plain values, its outline drawn again; InputError if they are not those of one."""
    try:
        state = FilterState(**{name: np.array(value, dtype=np.float64) for name, value in values["state"].items()})
        plain = values["anchor"]
        outer, joints, outer_rate, joint_rate = (
            np.array(plain[name], dtype=np.float64) for name in ("outer", "joints", "outer_rate", "joint_rate")
        )
        read = np.array(plain["joint_read"], dtype=np.bool_)
        anchor = Anchor(outer, joints, outer_rate, joint_rate, bool(plain["outer_read"]), read, bool(plain["based"]))
        drawn = values["rim"]
        rim = None if drawn is None else model.draw(*(np.array(part, dtype=np.float64) for part in drawn))
        return Hypothesis(state, anchor, float(values["sigma"]), float(values["score"]), str(values["relation"]), rim)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError("checkpoint: expected the state of a tracker, got something else") from None
