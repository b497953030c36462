"""Forward kinematics of a tree of joints for batches of joint values.

The transform of a revolute joint is affine in (sin q, cos q) by Rodrigues' formula,
``R = I + sin q K + (1 - cos q) K^2`` with ``K`` the cross-product matrix of the axis; that of a prismatic joint is
affine in q. The constant matrices are computed once; each batch needs one matrix sum for all joints together, and one
matrix product per joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.geometry import adjoint

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
    """A tree of K joints below a root link, ordered so that every parent precedes its children."""

    joints: tuple[Joint, ...]

    @cached_property
    def _moving(self) -> list[int]:
        """Indices of the M moving joints."""
        return [index for index, joint in enumerate(self.joints) if joint.moves]

    @cached_property
    def _values_by(self) -> tuple[list[int], NDArray[np.float64], NDArray[np.float64]]:
        """The moving joints' drivers and multipliers (M,), and the offsets (K,) of all."""
        moving = [self.joints[index] for index in self._moving]
        drivers = [joint.driver for joint in moving if joint.driver is not None]
        return drivers, np.array([joint.multiplier for joint in moving]), np.array([j.offset for j in self.joints])

    @cached_property
    def _terms(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Matrices (3, K, 4, 4) whose sum with weights 1, sin q, cos q is a joint's transform, and who is prismatic.

        For prismatic joints, (K, 1, 1), the weights are 1, q and 0.
        """
        terms = np.zeros((3, len(self.joints), 4, 4))
        for index, joint in enumerate(self.joints):
            constant, sine, cosine = np.eye(4), np.zeros((4, 4)), np.zeros((4, 4))
            if joint.motion == "prismatic":
                sine[:3, 3] = joint.axis
            elif joint.motion == "revolute":
                sine[:3, :3] = _cross_matrix(joint.axis)
                cosine[:3, :3] = -(sine[:3, :3] @ sine[:3, :3])
                constant[:3, :3] -= cosine[:3, :3]
            terms[:, index] = np.asarray(joint.parent_from_joint, dtype=np.float64) @ [constant, sine, cosine]
        prismatic = np.array([joint.motion == "prismatic" for joint in self.joints], dtype=np.bool_)
        return terms, prismatic[:, None, None]

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
        independent = np.asarray(joints, dtype=np.float64)
        batch = independent.shape[:-1]
        drivers, multipliers, offsets = self._values_by
        values = np.empty((*batch, len(offsets)))
        values[...] = offsets
        values[..., self._moving] += multipliers * independent[..., drivers]
        values = values[..., None, None]
        terms, prismatic = self._terms
        by_sine = np.where(prismatic, values, np.sin(values)) * terms[1]
        parent_from_child = terms[0] + by_sine + np.cos(values) * terms[2]
        poses = np.empty((*batch, len(offsets) + 1, 4, 4))
        poses[..., -1, :, :] = np.eye(4)
        for index, joint in enumerate(self.joints):
            local = parent_from_child[..., index, :, :]
            np.matmul(poses[..., joint.parent, :, :], local, out=poses[..., index, :, :])
        return poses[..., list(selected), :, :]

    @cached_property
    def _twists(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How each moving joint moves its child link, (M, 6, 1), and which of them carry which link, (K + 1, J, M).

        The motions are as in `twists`, in the axes of the child link. The links are the child links of the K joints,
        then the root link; values are 1 or 0 by the independent joint that drives the moving one.
        """
        motions = np.zeros((len(self._moving), 6, 1))
        drivers = self._values_by[0]
        carried = np.zeros((len(self.joints) + 1, max(drivers, default=-1) + 1, len(drivers)))
        for column, (index, driver) in enumerate(zip(self._moving, drivers, strict=True)):
            joint = self.joints[index]
            begin = 3 if joint.motion == "revolute" else 0
            motions[column, begin : begin + 3, 0] = joint.multiplier * joint.axis
            for link in range(len(self.joints)):
                carried[link, driver, column] = index in self.path(link)
        return motions, carried

    def twists(self, joints: NDArray[np.float64], selected: Sequence[int]) -> tuple[NDArray[np.float64], ...]:
        """Compute the poses (..., S, 4, 4) of selected links at joints (..., J), and their motions (..., S, 6, J).

        ``selected`` and the poses are as in `forward`. The motion is that by a unit of each joint: the velocity, m, of
        the link's point at the root link's origin, then the rotation, rad, both in the root link's axes.
        """
        motions, carried = self._twists
        poses = self.forward(joints, [*selected, *self._moving])
        links, hinges = poses[..., : len(selected), :, :], poses[..., len(selected) :, :, :]
        by_hinge = (adjoint(hinges) @ motions)[..., None, :, :, 0]  # (..., 1, M, 6)
        return links, (carried[list(selected)] @ by_hinge).swapaxes(-1, -2)

    def path(self, index: int) -> list[int]:
        """List the indices of the joints from the root link to one joint, inclusive."""
        path: list[int] = []
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        return path[::-1]
