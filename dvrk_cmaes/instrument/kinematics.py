"""Forward kinematics of a tree of joints, for whole batches of joint values at once.

A moving joint's transform is affine in (sin q, cos q) when it turns (Rodrigues' formula,
``R = I + sin q K + (1 - cos q) K^2`` with ``K`` the cross-product matrix of the axis) and affine in q when it
slides. The constant matrices are formed once; per batch each joint costs one sum and one product.
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
    """One joint of the tree and the link below it.

    The joint's value is ``multiplier * joints[..., driver] + offset``; a joint that nothing drives
    (``driver`` None) keeps the value ``offset``.

    Parameters
    ----------
    name
        Name of the joint.
    child
        Name of the link below.
    parent
        Index of the joint whose child link is this joint's parent link; -1 for the root link.
    motion
        How the child moves: not at all, about the axis, or along it.
    parent_from_joint : (4, 4)
        The child's frame in the parent's when the value is zero.
    axis : (3,)
        Unit axis of a turning joint; metres per unit of value of a sliding one. In the joint's frame.
    driver
        Column of the independent joint that moves this one, or None.
    multiplier, offset
        As above.
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
        """Whether an independent joint moves this one."""
        return self.motion != "fixed" and self.driver is not None and self.multiplier != 0.0


def _cross_matrix(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree of joints below a root link, in an order where every parent comes before its children."""

    joints: tuple[Joint, ...]
    _terms: tuple[tuple[NDArray[np.float64], ...], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_terms", tuple(self._constant_terms(joint) for joint in self.joints))

    @staticmethod
    def _constant_terms(joint: Joint) -> tuple[NDArray[np.float64], ...]:
        """Matrices whose sum, weighted with 1, sin q, cos q (or with 1, q), is the joint's transform."""
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
        """Parent link from child link of one joint: (4, 4) if nothing moves it, else (..., 4, 4)."""
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

    def forward(self, joints: ArrayLike, wanted: Sequence[int]) -> NDArray[np.float64]:
        """Poses of some links in the root link's frame.

        Parameters
        ----------
        joints : (..., J)
            Values of the independent joints, rad or m.
        wanted
            Indices of joints, whose child links' poses are asked for; -1 stands for the root link.

        Returns
        -------
        root_from_link : (..., len(wanted), 4, 4)
        """
        values = np.asarray(joints, dtype=np.float64)
        poses: list[NDArray[np.float64]] = []
        for index, joint in enumerate(self.joints):
            local = self.joint_transform(index, values)
            poses.append(local if joint.parent < 0 else poses[joint.parent] @ local)
        out = np.empty((*values.shape[:-1], len(wanted), 4, 4))
        for column, index in enumerate(wanted):
            out[..., column, :, :] = np.eye(4) if index < 0 else poses[index]
        return out

    def path(self, index: int) -> list[int]:
        """Joints from the root down to (and with) one joint."""
        path: list[int] = []
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        return path[::-1]
