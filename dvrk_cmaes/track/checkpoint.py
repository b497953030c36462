"""State of a tracker as plain values, from which another tracker goes on with the same results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.track.hypothesis import Hypothesis
from dvrk_cmaes.track.motion import Anchor
from dvrk_cmaes.track.outline_model import OutlineModel
from dvrk_cmaes.track.state import FilterState, Layout

Float64 = NDArray[np.float64]


def plain_hypothesis(hypothesis: Hypothesis) -> dict[str, Any]:
    """Return a hypothesis as plain values; their text in JSON has all digits."""
    outline, drawn = hypothesis.outline, None
    if outline is not None:
        drawn = [outline.at.pose.tolist(), outline.at.joints.tolist(), list(outline.views)]
    return {
        "state": _plain(hypothesis.state),
        "anchor": _plain(hypothesis.anchor),
        "sigma": hypothesis.sigma,
        "score": hypothesis.score,
        "relation": hypothesis.relation,
        "rim": drawn,
    }


def _plain(part: object) -> dict[str, Any]:
    """Return the fields of a dataclass, arrays as lists."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}  # type: ignore[arg-type]
    for of_one_image in ("frozen", "sparse"):  # that is not solved again
        values.pop(of_one_image, None)
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def read_hypothesis(values: Mapping[str, Any], model: OutlineModel) -> Hypothesis:
    """Return the hypothesis of plain values, its outline drawn again; InputError if they are not those of one."""
    joints_read = len(model.instrument.joint_names)
    size = Layout(joints_read).size
    shapes = {
        "camera_from_base": (4, 4),
        "offsets": (1 + joints_read,),
        "slack": (4, 4),
        "rate": (6 + joints_read,),
        "covariance": (size, size),
    }
    try:
        state = FilterState(**{name: _array(values["state"][name], shape) for name, shape in shapes.items()})
        plain = values["anchor"]
        outer, outer_rate = (_array(plain[name], (4,)) for name in ("outer", "outer_rate"))
        joints, joint_rate = (_array(plain[name], (joints_read,)) for name in ("joints", "joint_rate"))
        read = np.array(plain["joint_read"], dtype=np.bool_).reshape(joints_read)
        anchor = Anchor(outer, joints, outer_rate, joint_rate, bool(plain["outer_read"]), read, bool(plain["based"]))
        if plain["expected"] is not None:
            anchor = replace(anchor, expected=_array(plain["expected"], (1 + joints_read,)))
        sigma, score = (float(_array(values[name], ())) for name in ("sigma", "score"))
        drawn = values["rim"]
        outline = None
        if drawn is not None:
            views = tuple(range(len(model.rig.views))[number] for number in drawn[2])
            outline = model.draw(Posed(_array(drawn[0], (4, 4)), _array(drawn[1], (joints_read,))), views)
        return Hypothesis(state, anchor, sigma, score, str(values["relation"]), outline)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        raise InputError("checkpoint: expected the state of a tracker, got something else") from None


def _array(value: object, shape: tuple[int, ...]) -> Float64:
    """Return finite numbers of a shape; ValueError for others."""
    array = np.array(value, dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError
    return array
