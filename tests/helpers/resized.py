"""Instruments whose shaft is thicker, or all of which is larger."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes import Body
from dvrk_cmaes.instrument.kinematics import Chain


def with_shaft(body: Body, scale: float) -> Body:
    """Give the instrument whose shaft is thicker by a factor; its other links stay as they are."""
    instrument = body.instrument
    assert instrument.shaft is not None
    shaft, first = instrument.shaft, instrument.links[0]
    from_axis = first.vertices - shaft.point
    along = (from_axis @ shaft.direction)[:, None] * shaft.direction
    links = (replace(first, vertices=shaft.point + along + scale * (from_axis - along)), *instrument.links[1:])
    return Body.prepare(replace(instrument, links=links, shaft=replace(shaft, radius=scale * shaft.radius)))


def with_size(body: Body, scale: float) -> Body:
    """Give the instrument all of which is larger by a factor."""
    instrument, sizes = body.instrument, np.array([*[[1.0, 1.0, 1.0, scale]] * 3, [1.0] * 4])
    assert instrument.shaft is not None
    joints = [replace(one, parent_from_joint=sizes * one.parent_from_joint) for one in instrument.chain.joints]
    links = [replace(link, vertices=scale * link.vertices) for link in instrument.links]
    shaft = replace(instrument.shaft, point=scale * instrument.shaft.point, radius=scale * instrument.shaft.radius)
    return Body.prepare(replace(instrument, links=tuple(links), chain=Chain(tuple(joints)), shaft=shaft))
