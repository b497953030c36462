"""Forward kinematics of a tree of joints for batches of joint values.

The transform of a revolute joint is affine in (sin q, cos q) by Rodrigues' formula,
``R = I + sin q K + (1 - cos q) K^2`` with ``K`` the cross-product matrix of the axis; that of a prismatic joint is
affine in q. The constant matrices are computed once; the kernel computes their sums and products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dvrk_cmaes import _kernel
from dvrk_cmaes.geometry import Float64, skew

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
    parent_from_joint: Float64
    axis: Float64
    driver: int | None = None
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def moves(self) -> bool:
        """Whether the value of an independent joint changes this joint's transform."""
        return self.motion != "fixed" and self.driver is not None and self.multiplier != 0.0


def _terms(joint: Joint) -> Float64:
    """Compute the matrices (3, 4, 4) whose sum with weights 1, sin q (or q) and cos q is the joint's transform."""
    origin = np.asarray(joint.parent_from_joint, dtype=np.float64)
    moving, cosine, constant = np.zeros((4, 4)), np.zeros((4, 4)), np.eye(4)
    if joint.motion == "prismatic":
        moving[:3, 3] = joint.axis
    elif joint.motion == "revolute":
        cross = skew(joint.axis)
        moving[:3, :3] = cross
        cosine[:3, :3] = -(cross @ cross)
        constant[:3, :3] -= cosine[:3, :3]
    return np.stack([origin @ constant, origin @ moving, origin @ cosine])


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree of joints below a root link, ordered so that every parent precedes its children."""

    joints: tuple[Joint, ...]

    @cached_property
    def _kernel(self) -> _kernel.Chain:
        """The tree as the kernel takes it."""
        return _kernel.Chain(
            [joint.parent for joint in self.joints],
            [joint.driver if joint.moves and joint.driver is not None else -1 for joint in self.joints],
            [joint.motion == "prismatic" for joint in self.joints],
            [joint.multiplier for joint in self.joints],
            [joint.offset for joint in self.joints],
            np.array([_terms(joint) for joint in self.joints]).reshape(-1, 3, 4, 4),
        )

    def __getstate__(self) -> tuple[Joint, ...]:
        """Pickle the joints."""
        return self.joints

    def __setstate__(self, joints: tuple[Joint, ...]) -> None:
        """Take the joints."""
        object.__setattr__(self, "joints", joints)

    def forward(self, joints: ArrayLike, selected: Sequence[int]) -> Float64:
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
        poses, _ = self._kernel.forward(_rows(values), selected, False)
        return poses.reshape(*values.shape[:-1], len(selected), 4, 4)

    def forward_with_derivatives(self, joints: Float64, selected: Sequence[int]) -> tuple[Float64, Float64]:
        """Compute the poses of selected links as `forward`, and their derivatives (..., J, len(selected), 4, 4)."""
        poses, by_joint = self._kernel.forward(_rows(joints), selected, True)
        assert by_joint is not None
        before, count = joints.shape[:-1], len(selected)
        return poses.reshape(*before, count, 4, 4), by_joint.reshape(*before, joints.shape[-1], count, 4, 4)

    def path(self, index: int) -> list[int]:
        """List the indices of the joints from the root link to one joint, inclusive."""
        path: list[int] = []
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        return path[::-1]


def _rows(values: Float64) -> Float64:
    """Return values (..., J) as rows (N, J)."""
    return np.ascontiguousarray(values.reshape(prod(values.shape[:-1]), values.shape[-1]))
