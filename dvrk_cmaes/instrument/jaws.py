"""Detection of an instrument's two jaws and of the tips of their meshes."""

from __future__ import annotations

import itertools

import numpy as np

from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.model import Instrument, JawTip
from dvrk_cmaes.instrument.sections import Slicer, edges_of

_END = 0.005  # distance of the tip from the last vertex, as a fraction of the jaw's length
_LAST_PART = np.linspace(0.01, 0.08, 8)  # distances of sections from the last vertex, fractions of the jaw's length


def find_jaw_tips(instrument: Instrument) -> tuple[JawTip, ...]:
    """Find the tips of the two jaws, each in its jaw link's frame; empty for an instrument without a pair of jaws.

    The jaws are the two links that one independent joint turns about a common axis by opposite angles. Closed (joint
    value zero), both extend from that axis in the same direction. Along that direction, a tip is half a percent of the
    jaw's length before the last vertex of its mesh; across it, the tip is the mean centre of sections through the last
    part of the jaw, so that it does not depend on single vertices or teeth.
    """
    pair = _opposite_pair(instrument)
    if pair is None:
        return ()
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    rotations = [poses[link, :3, :3] for link in pair]
    axes = [instrument.chain.joints[instrument.link_joints[link]].axis for link in pair]
    extent = np.zeros(3)
    for link, rotation, axis in zip(pair, rotations, axes, strict=True):
        extent += rotation @ _vector_to_farthest(instrument.links[link].vertices, axis)
    tips: list[JawTip] = []
    for link, rotation, axis in zip(pair, rotations, axes, strict=True):
        direction = rotation.T @ extent
        direction -= (direction @ axis) * axis
        direction /= np.linalg.norm(direction)
        mesh = instrument.links[link]
        slicer = Slicer(mesh.vertices, edges_of(mesh.faces), direction)
        sections = [slicer.at(slicer.high * (1.0 - part)) for part in _LAST_PART]
        centres = [section.centre for section in sections if section is not None]
        far = mesh.vertices[np.argmax(mesh.vertices @ direction)]
        across = np.mean(centres, axis=0) if centres else slicer.basis @ far
        position = across @ slicer.basis + slicer.high * (1.0 - _END) * direction
        tips.append(JawTip(link, position))
    return tuple(tips)


def _opposite_pair(instrument: Instrument) -> tuple[int, int] | None:
    """Find the indices of two links that one joint turns by opposite angles about a common axis; None without such."""
    joints = instrument.chain.joints
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    turning = [
        (link, joints[above], poses[link])
        for link, above in enumerate(instrument.link_joints)
        if above >= 0 and joints[above].moves and joints[above].motion == "revolute"
    ]
    for (link, joint, pose), (other_link, other, other_pose) in itertools.combinations(turning, 2):
        if joint.driver != other.driver or joint.parent != other.parent:
            continue
        rates = joint.multiplier * pose[:3, :3] @ joint.axis + other.multiplier * other_pose[:3, :3] @ other.axis
        gap = np.cross(pose[:3, 3] - other_pose[:3, 3], pose[:3, :3] @ joint.axis)
        if np.linalg.norm(rates) < 1e-3 * abs(joint.multiplier) and np.linalg.norm(gap) < 1e-4:
            return link, other_link
    return None


def _vector_to_farthest(vertices: Float64, axis: Float64) -> Float64:
    """Return the vector (3,) from an axis through the origin to the vertex farthest from the axis."""
    away = vertices - np.outer(vertices @ axis, axis)
    return np.asarray(away[np.argmax(np.linalg.norm(away, axis=1))])
