"""Replacement of an instrument's joint limits and roll offset by those of a dVRK tool description."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.dvrk_description import Tool
from dvrk_cmaes.instrument.model import Instrument

_WRIST_TOLERANCE = 5e-4  # m; different tools differ by at least 1 mm, descriptions of one tool by rounding


def with_tool(instrument: Instrument, tool: Tool) -> Instrument:
    """Return an instrument with a tool's limits, roll offset and roll limits.

    Joints that the tool does not describe keep the instrument's limits.

    Raises
    ------
    InputError
        The distance between the wrist axes differs from the instrument's: the description is of another tool.
    """
    for joint in instrument.chain.joints:
        length = float(np.linalg.norm(joint.parent_from_joint[:3, 3]))
        if joint.name == "wrist_yaw" and abs(length - tool.wrist_length) > _WRIST_TOLERANCE:
            raise InputError(
                f"{tool.name}: wrist_yaw: expected A {1e3 * length:.2f} mm as in {instrument.name}, "
                f"got {1e3 * tool.wrist_length:.2f} mm: another tool"
            )
    limits = instrument.limits.copy()
    for index, name in enumerate(instrument.joint_names):
        limits[index] = tool.limits.get(name, limits[index])
    return replace(
        instrument, limits=limits, limits_from=tool.name, roll_offset=tool.roll_offset, roll_limits=tool.limits["roll"]
    )
