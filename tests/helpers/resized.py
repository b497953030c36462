"""Instruments of which one part is larger, or the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes import Body
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.kinematics import Chain
from dvrk_cmaes.instrument.model import Link


def with_shaft(body: Body, scale: float) -> Body:
    """Give the instrument whose shaft is thicker by a factor; its other links stay as they are."""
    instrument = body.instrument
    assert instrument.shaft is not None
    shaft, first = instrument.shaft, instrument.links[0]
    from_axis = first.vertices - shaft.point
    along = (from_axis @ shaft.direction)[:, None] * shaft.direction
    links = (replace(first, vertices=shaft.point + along + scale * (from_axis - along)), *instrument.links[1:])
    return Body.prepare(replace(instrument, links=links, shaft=replace(shaft, radius=scale * shaft.radius)))


def longer(link: Link, end: Float64, scale: float) -> Link:
    """Give a link of which what is between its origin and an end (3,) is longer by a factor."""
    share = np.clip(link.vertices @ end / (end @ end), 0.0, 1.0)
    return replace(link, vertices=link.vertices + (scale - 1) * share[:, None] * end)


def with_wrist(body: Body, scale: float) -> Body:
    """Give the instrument whose jaws' axis is farther from the wrist's by a factor."""
    instrument = body.instrument
    first, last = instrument.hinges
    end = instrument.chain.joints[last].parent_from_joint[:3, 3]
    farther = np.eye(4)
    farther[:3, 3] = (scale - 1) * end
    joints = [
        replace(one, parent_from_joint=farther @ one.parent_from_joint) if one.parent == first else one
        for one in instrument.chain.joints
    ]
    links = [
        longer(link, end, scale) if joint == first else link
        for link, joint in zip(instrument.links, instrument.link_joints, strict=True)
    ]
    return Body.prepare(replace(instrument, links=tuple(links), chain=Chain(tuple(joints))))


def with_jaws(body: Body, scale: float) -> Body:
    """Give the instrument whose jaws are longer by a factor."""
    links = list(body.instrument.links)
    for tip in body.instrument.jaw_tips:
        links[tip.link] = longer(links[tip.link], tip.position, scale)
    return Body.prepare(replace(body.instrument, links=tuple(links)))


def with_size(body: Body, scale: float) -> Body:
    """Give the instrument all of which is larger by a factor."""
    instrument, sizes = body.instrument, np.array([*[[1.0, 1.0, 1.0, scale]] * 3, [1.0] * 4])
    assert instrument.shaft is not None
    joints = [replace(one, parent_from_joint=sizes * one.parent_from_joint) for one in instrument.chain.joints]
    links = [replace(link, vertices=scale * link.vertices) for link in instrument.links]
    shaft = replace(instrument.shaft, point=scale * instrument.shaft.point, radius=scale * instrument.shaft.radius)
    return Body.prepare(replace(instrument, links=tuple(links), chain=Chain(tuple(joints)), shaft=shaft))
