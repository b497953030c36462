"""Measurements on an instrument's meshes: shaft, jaw tips, and similarity to its mirror twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument.cylinder import Cylinder, find_cylinder
from dvrk_cmaes.instrument.jaws import find_jaw_tips
from dvrk_cmaes.instrument.model import Instrument, Shaft
from dvrk_cmaes.instrument.symmetry import resembles_twin

_RADII = (0.25e-3, 25e-3)  # m, of shafts; those of instruments have 1.5 to 8 mm


def with_measurements(instrument: Instrument) -> Instrument:
    """Return an instrument with its shaft, jaw tips and ``has_twin`` measured on its meshes.

    Raises
    ------
    InputError
        The shaft is as thin or thick as with meshes in other units than those of the URDF.
    """
    instrument = replace(instrument, shaft=(shaft := _shaft(instrument)))
    if shaft is not None and not _RADII[0] <= shaft.radius <= _RADII[1]:
        raise InputError(
            f"{instrument.name}: expected a shaft with a radius of {1e3 * _RADII[0]:g} to {1e3 * _RADII[1]:g} mm, got "
            f"{1e3 * shaft.radius:.3g} mm: are the meshes in metres? (scale in the URDF changes their unit)"
        )
    instrument = replace(instrument, jaw_tips=find_jaw_tips(instrument))
    return replace(instrument, has_twin=resembles_twin(instrument))


def _shaft(instrument: Instrument) -> Shaft | None:
    """Find the cylinder of the first link on which no joint moves the axis and the wrist lies beyond one end."""
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    for index, link in enumerate(instrument.links):
        vertices = link.vertices @ poses[index, :3, :3].T + poses[index, :3, 3]
        cylinder = find_cylinder(vertices, link.faces)
        if cylinder is None or not _has_fixed_axis(instrument, index, cylinder):
            continue
        oriented = _oriented_to_wrist(instrument, index, cylinder)
        if oriented is not None:
            return Shaft(
                point=oriented.point,
                direction=oriented.direction,
                radius=oriented.radius,
                distal_end=oriented.high,
                proximal_end=oriented.low,
            )
    return None


def _has_fixed_axis(instrument: Instrument, index: int, cylinder: Cylinder) -> bool:
    """Whether no joint value moves the axis of a link's cylinder, as on the root link or a link rolling about it."""
    if instrument.link_joints[index] < 0:
        return True
    weights = np.random.default_rng(0).uniform(size=(8, len(instrument.joint_names)))
    joints = instrument.limits[:, 0] * (1 - weights) + instrument.limits[:, 1] * weights
    zero = instrument.forward(np.zeros(len(instrument.joint_names)))[index]
    moved = instrument.forward(joints)[:, index] @ np.linalg.inv(zero)
    ends = np.stack([cylinder.point + end * cylinder.direction for end in (cylinder.low, cylinder.high)])
    shifts = apply(moved, ends) - ends
    return bool(np.linalg.norm(shifts, axis=-1).max() < 1e-4)


def _oriented_to_wrist(instrument: Instrument, index: int, cylinder: Cylinder) -> Cylinder | None:
    """Orient a link's cylinder towards the links below it; None if these do not lie beyond one of its ends.

    This excludes wrist pins: the links below them lie between the ends of the cylinder. The cylinder of an instrument
    with a single link is oriented so that the largest component of its direction is positive.
    """
    others = [k for k in range(len(instrument.links)) if k != index]
    if not others:
        positive = cylinder.direction[np.argmax(np.abs(cylinder.direction))] > 0
        return cylinder if positive else _reversed(cylinder)
    above = instrument.link_joints[index]
    below = [k for k in others if above < 0 or above in instrument.chain.path(instrument.link_joints[k])]
    if not below:
        return None
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    middles = [poses[k, :3, 3] + poses[k, :3, :3] @ instrument.links[k].vertices.mean(axis=0) for k in below]
    along = float(np.mean(middles, axis=0) @ cylinder.direction)
    if cylinder.low <= along <= cylinder.high:
        return None
    return _reversed(cylinder) if along < cylinder.low else cylinder


def _reversed(cylinder: Cylinder) -> Cylinder:
    """Return the same cylinder with the opposite direction."""
    return Cylinder(cylinder.point, -cylinder.direction, cylinder.radius, -cylinder.high, -cylinder.low)
