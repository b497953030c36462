"""Forward kinematics of a tree of joints for batches of joint values.

The transform of a revolute joint is affine in (sin q, cos q) by Rodrigues' formula,
``R = I + sin q K + (1 - cos q) K^2`` with ``K`` the cross-product matrix of the axis; that of a prismatic joint is
affine in q. The constant matrices are computed once; each batch needs one matrix sum and one matrix product per joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Motion = Literal["fixed", "revolute", "prismatic"]


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint of the tree and its child link.

    The joint's value is ``multiplier * joints[..., driver] + offset``; without a ``driver`` it is ``offset``.

    Parameters
    ----------
    name
        Name of the joint.
    child
        Name of the child link.
    parent
        Index of the joint whose child link is this joint's parent link; -1 for the root link.
    motion
        Kind of motion of the child link: none, rotation about the axis, or translation along it.
    parent_from_joint : (4, 4)
        Pose of the child frame in the parent frame at value zero.
    axis : (3,)
        In the joint's frame: a unit vector for a revolute joint, metres per unit of value for a prismatic one.
    driver
        Column of the independent joint that determines this one's value, or None.
    multiplier, offset
        Factor and constant of the formula above.
    """

    name: str
    child: str
    parent: int
    motion: Motion
    parent_from_joint: NDArray[np.float64]
    axis: NDArray[np.float64]
    driver: int | None = None
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether the value of an independent joint changes this joint's transform."""
        return self.motion != "fixed" and self.driver is not None and self.multiplier != 0.0


def _cross_matrix(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross-product matrix (3, 3) of a vector (3,)."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree of joints below a root link, ordered so that every parent precedes its children."""

    joints: tuple[Joint, ...]
    _terms: tuple[tuple[NDArray[np.float64], ...], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_terms", tuple(self._constant_terms(joint) for joint in self.joints))

    @staticmethod
    def _constant_terms(joint: Joint) -> tuple[NDArray[np.float64], ...]:
        """Compute the matrices whose sum with weights 1, sin q, cos q (or 1, q) is the joint's transform."""
        origin = np.asarray(joint.parent_from_joint, dtype=np.float64)
        if joint.motion == "fixed":
            return (origin,)
        moving = np.zeros((4, 4))
        if joint.motion == "prismatic":
            moving[:3, 3] = joint.axis
            return (origin, origin @ moving)
        cross = _cross_matrix(joint.axis)
        constant, cosine = np.eye(4), np.zeros((4, 4))
        moving[:3, :3] = cross
        cosine[:3, :3] = -(cross @ cross)
        constant[:3, :3] -= cosine[:3, :3]
        return (origin @ constant, origin @ moving, origin @ cosine)

    def joint_transform(self, index: int, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute parent_from_child of one joint: (4, 4) for a fixed value, else (..., 4, 4)."""
        joint, terms = self.joints[index], self._terms[index]
        value: NDArray[np.float64] = np.asarray(joint.offset)
        if joint.driver is not None:
            value = joint.multiplier * joints[..., joint.driver] + joint.offset
        if joint.motion == "fixed":
            return terms[0]
        value = value[..., None, None]
        if joint.motion == "prismatic":
            return np.asarray(terms[0] + value * terms[1])
        return np.asarray(terms[0] + np.sin(value) * terms[1] + np.cos(value) * terms[2])

    def forward(self, joints: ArrayLike, selected: Sequence[int]) -> NDArray[np.float64]:
        """Compute the poses of selected links in the root link's frame.

        Parameters
        ----------
        joints : (..., J)
            Values of the independent joints, rad or m.
        selected
            Indices of the joints whose child links' poses are returned; -1 denotes the root link.

        Returns
        -------
        (..., len(selected), 4, 4)
            root_from_link of each.
        """
        values = np.asarray(joints, dtype=np.float64)
        poses: list[NDArray[np.float64]] = []
        for index, joint in enumerate(self.joints):
            local = self.joint_transform(index, values)
            poses.append(local if joint.parent < 0 else poses[joint.parent] @ local)
        out = np.empty((*values.shape[:-1], len(selected), 4, 4))
        for column, index in enumerate(selected):
            out[..., column, :, :] = np.eye(4) if index < 0 else poses[index]
        return out

    def path(self, index: int) -> list[int]:
        """List the indices of the joints from the root link to one joint, inclusive."""
        path: list[int] = []
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        return path[::-1]
