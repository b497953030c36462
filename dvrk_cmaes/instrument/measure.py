"""What is measured on an instrument's meshes when it is loaded: shaft, jaw tips, likeness to its mirror twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument.cylinder import Cylinder, find_cylinder
from dvrk_cmaes.instrument.jaws import find_jaw_tips
from dvrk_cmaes.instrument.model import Instrument, Shaft
from dvrk_cmaes.instrument.symmetry import looks_like_its_twin

Axis = tuple[NDArray[np.float64], NDArray[np.float64]]


def measured(instrument: Instrument, *, radius: float | None = None, axis: Axis | None = None) -> Instrument:
    """Complete an instrument with its shaft, jaw tips and whether it has a mirror twin.

    Parameters
    ----------
    instrument
        One without shaft and tips.
    radius
        In metres, instead of the measured one.
    axis
        Point (3,) in metres and unit direction (3,), distal, in the root link's frame, instead of the measured one.

    Raises
    ------
    InputError
        A radius that is not positive; a radius or an axis alone where the other cannot be measured.
    """
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise InputError(f"shaft_radius: expected a positive number of metres, got {radius!r}")
    instrument = replace(instrument, shaft=_shaft(instrument, radius, axis))
    instrument = replace(instrument, jaw_tips=find_jaw_tips(instrument))
    return replace(instrument, has_twin=looks_like_its_twin(instrument))


def _shaft(instrument: Instrument, radius: float | None, axis: Axis | None) -> Shaft | None:
    """Shaft on the first link that has one and whose axis stays put in the root link's frame."""
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    for index, link in enumerate(instrument.links):
        vertices = link.vertices @ poses[index, :3, :3].T + poses[index, :3, 3]
        cylinder = find_cylinder(vertices, link.faces, axis)
        if cylinder is not None and _stays(instrument, index, cylinder):
            if axis is None:
                cylinder = _pointing_distally(instrument, index, cylinder)
            return Shaft(
                cylinder.point, cylinder.direction, cylinder.radius if radius is None else radius,
                distal_end=cylinder.high, proximal_end=cylinder.low,
            )  # fmt: skip
    if axis is None and radius is None:
        return None
    if axis is None or radius is None:
        given, missing = ("shaft_radius", "shaft_axis") if axis is None else ("shaft_axis", "shaft_radius")
        raise InputError(
            f"{instrument.name}: no straight cylinder found on the meshes to complete {given}: give {missing} too"
        )
    along = (instrument.links[0].vertices @ poses[0, :3, :3].T + poses[0, :3, 3]) @ axis[1]
    return Shaft(axis[0], axis[1], radius, distal_end=float(along.max()), proximal_end=float(along.min()))


def _stays(instrument: Instrument, index: int, cylinder: Cylinder) -> bool:
    """Whether a link's cylinder keeps its axis whatever the joints: on the root, or on a link that rolls about it."""
    if instrument.link_joints[index] < 0:
        return True
    weights = np.random.default_rng(0).uniform(size=(8, len(instrument.joint_names)))
    joints = instrument.limits[:, 0] * (1 - weights) + instrument.limits[:, 1] * weights
    zero = instrument.forward(np.zeros(len(instrument.joint_names)))[index]
    moved = instrument.forward(joints)[:, index] @ np.linalg.inv(zero)
    ends = np.stack([cylinder.point + end * cylinder.direction for end in (cylinder.low, cylinder.high)])
    shifts = ends @ np.swapaxes(moved[:, :3, :3], -1, -2) + moved[:, None, :3, 3] - ends
    return bool(np.linalg.norm(shifts, axis=-1).max() < 1e-4)


def _pointing_distally(instrument: Instrument, index: int, cylinder: Cylinder) -> Cylinder:
    """Turn a cylinder's direction towards the links below, or the frame's origin if there are none."""
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    below = [
        poses[k, :3, 3] + poses[k, :3, :3] @ link.vertices.mean(axis=0)
        for k, link in enumerate(instrument.links)
        if k > index
    ]
    goal = np.mean(below, axis=0) if below else poses[index, :3, 3]
    if goal @ cylinder.direction >= (cylinder.low + cylinder.high) / 2:
        return cylinder
    return Cylinder(cylinder.point, -cylinder.direction, cylinder.radius, -cylinder.high, -cylinder.low)
