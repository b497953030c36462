"""The two jaws of an instrument and the far ends of their meshes."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.instrument.model import Instrument, JawTip
from dvrk_cmaes.instrument.sections import Slicer, edges_of

_END = 0.005  # of the jaw's length: how far short of the last vertex the tip lies
_LAST_PART = np.linspace(0.01, 0.08, 8)  # of the jaw's length: sections whose middle is the tip's


def find_jaw_tips(instrument: Instrument) -> tuple[JawTip, ...]:
    """Far ends of the two jaws, each in its jaw link's frame; empty for an instrument without a pair of jaws.

    The jaws are the two links that one independent joint turns about one axis by opposite angles. Both reach
    away from that axis in one direction when they are closed (joint at zero). Along that direction a jaw's tip is
    where its mesh ends, but for half a percent; across it, the middle of the sections through its last part, so
    that neither single vertices nor teeth decide.
    """
    pair = _opposite_pair(instrument)
    if pair is None:
        return ()
    poses = instrument.forward(np.zeros(len(instrument.joint_names)))
    rotations = [poses[link, :3, :3] for link in pair]
    axes = [instrument.chain.joints[instrument.link_joints[link]].axis for link in pair]
    reaching = np.zeros(3)
    for link, turn, axis in zip(pair, rotations, axes, strict=True):
        reaching += turn @ _farthest(instrument.links[link].vertices, axis)
    tips: list[JawTip] = []
    for link, turn, axis in zip(pair, rotations, axes, strict=True):
        direction = turn.T @ reaching
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
    """Two links that one joint turns by opposite angles about one axis, or None."""
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


def _farthest(vertices: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vector (3,) from an axis through the origin to the vertex farthest from it."""
    away = vertices - np.outer(vertices @ axis, axis)
    return np.asarray(away[np.argmax(np.linalg.norm(away, axis=1))])
