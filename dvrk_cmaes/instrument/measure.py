"""What is measured on an instrument's meshes when it is loaded: shaft, jaw tips, likeness to its mirror twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import apply
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
    """Shaft on the first link with a cylinder whose axis stays put and at whose end the wrist begins."""
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    for index, link in enumerate(instrument.links):
        vertices = link.vertices @ poses[index, :3, :3].T + poses[index, :3, 3]
        found = find_cylinder(vertices, link.faces, axis)
        if found is None or not _stays(instrument, index, found):
            continue
        cylinder = _ending_at_the_wrist(instrument, index, found, turn=axis is None)
        if cylinder is not None:
            return Shaft(
                point=cylinder.point,
                direction=cylinder.direction,
                radius=cylinder.radius if radius is None else radius,
                distal_end=cylinder.high,
                proximal_end=cylinder.low,
            )
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
    shifts = apply(moved, ends) - ends
    return bool(np.linalg.norm(shifts, axis=-1).max() < 1e-4)


def _ending_at_the_wrist(instrument: Instrument, index: int, cylinder: Cylinder, *, turn: bool) -> Cylinder | None:
    """Point a link's cylinder towards the links below it; None if they do not lie beyond one of its ends.

    A wrist pin is a cylinder too, but what hangs on it lies about its middle. An instrument of one link is all
    shaft, and points towards positive coordinates. Without `turn` the direction is left as it is.
    """
    others = [k for k in range(len(instrument.links)) if k != index]
    if not others:
        positive = cylinder.direction[np.argmax(np.abs(cylinder.direction))] > 0
        return cylinder if positive or not turn else _turned(cylinder)
    above = instrument.link_joints[index]
    below = [k for k in others if above < 0 or above in instrument.chain.path(instrument.link_joints[k])]
    if not below:
        return None
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    middles = [poses[k, :3, 3] + poses[k, :3, :3] @ instrument.links[k].vertices.mean(axis=0) for k in below]
    along = float(np.mean(middles, axis=0) @ cylinder.direction)
    if cylinder.low <= along <= cylinder.high:
        return None
    return _turned(cylinder) if turn and along < cylinder.low else cylinder


def _turned(cylinder: Cylinder) -> Cylinder:
    return Cylinder(cylinder.point, -cylinder.direction, cylinder.radius, -cylinder.high, -cylinder.low)
