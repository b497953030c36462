"""Forward kinematics of a tree of joints for batches of joint values.

The transform of a revolute joint is affine in (sin q, cos q) by Rodrigues' formula,
``R = I + sin q K + (1 - cos q) K^2`` with ``K`` the cross-product matrix of the axis; that of a prismatic joint is
affine in q. The constant matrices are computed once; each batch needs one sum of matrices for all joints together, and
one matrix product for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Motion = Literal["fixed", "revolute", "prismatic"]

_NO_CONTENT = {"content": False}  # of fields that follow from others


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
class _Moving:
    """The K joints of a chain whose transforms change: ``at`` are their indices in the chain.

    Their values are ``multiplier * joints[..., driver] + offset``, (..., K), their transforms the sums of the constant
    matrices ``terms`` (3, K, 4, 4), the second of which is multiplied by the sine of the value, or by the value itself
    for ``sliding`` joints, and the third by the cosine.
    """

    at: tuple[int, ...]
    driver: NDArray[np.intp]
    multiplier: NDArray[np.float64]
    offset: NDArray[np.float64]
    sliding: NDArray[np.bool_]
    terms: NDArray[np.float64]

    @staticmethod
    def of(joints: Sequence[Joint]) -> _Moving:
        """Select those joints that move with one of the independent joints, and compute their constant matrices."""
        chosen = [(index, joint, joint.driver) for index, joint in enumerate(joints)]
        moving = [(index, joint, driver) for index, joint, driver in chosen if joint.moves and driver is not None]
        return _Moving(
            tuple(index for index, _, _ in moving),
            np.array([driver for _, _, driver in moving], dtype=np.intp),
            np.array([joint.multiplier for _, joint, _ in moving]),
            np.array([joint.offset for _, joint, _ in moving]),
            np.array([joint.motion == "prismatic" for _, joint, _ in moving], dtype=np.bool_),
            np.array([_constant_terms(joint) for _, joint, _ in moving]).reshape(-1, 3, 4, 4).swapaxes(0, 1),
        )

    def values(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the values (..., K) of these joints from those of the independent ones (..., J)."""
        return np.asarray(self.multiplier * joints.take(self.driver, axis=-1) + self.offset)

    def derivatives(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute the derivatives (..., K, 4, 4) of `transforms`, each by the independent joint that moves it."""
        value = self.values(joints)
        _, first, second = self.terms
        of_first = np.where(self.sliding, 1.0, np.cos(value))
        change = of_first[..., None, None] * first - np.sin(value)[..., None, None] * second
        return np.asarray(self.multiplier[:, None, None] * change)

    def transforms(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute parent_from_child (..., K, 4, 4) of these joints from the values of the independent ones (..., J)."""
        value = self.values(joints)
        constant, first, second = self.terms
        of_first, of_second = np.sin(value), np.cos(value)
        if self.sliding.any():
            of_first = np.where(self.sliding, value, of_first)
        out = of_first[..., None, None] * first
        out += constant
        out += of_second[..., None, None] * second
        return np.asarray(out)


def _constant_terms(joint: Joint) -> NDArray[np.float64]:
    """Compute the matrices (3, 4, 4) whose sum with weights 1, sin q (or q) and cos q is the joint's transform."""
    origin = np.asarray(joint.parent_from_joint, dtype=np.float64)
    moving, cosine, constant = np.zeros((4, 4)), np.zeros((4, 4)), np.eye(4)
    if joint.motion == "prismatic":
        moving[:3, 3] = joint.axis
    elif joint.motion == "revolute":
        cross = _cross_matrix(joint.axis)
        moving[:3, :3] = cross
        cosine[:3, :3] = -(cross @ cross)
        constant[:3, :3] -= cosine[:3, :3]
    return np.stack([origin @ constant, origin @ moving, origin @ cosine])


def _at_rest(joint: Joint) -> NDArray[np.float64]:
    """Compute the transform (4, 4) of a joint that no independent joint moves."""
    constant, first, second = _constant_terms(joint)
    value = joint.offset
    of_first = value if joint.motion == "prismatic" else np.sin(value)
    return np.asarray(constant + of_first * first + np.cos(value) * second)


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree of joints below a root link, ordered so that every parent precedes its children."""

    joints: tuple[Joint, ...]
    _moving: _Moving = field(init=False, repr=False, metadata=_NO_CONTENT)
    _still: dict[int, NDArray[np.float64]] = field(init=False, repr=False, metadata=_NO_CONTENT)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_moving", _Moving.of(self.joints))
        still = {index: _at_rest(joint) for index, joint in enumerate(self.joints) if index not in self._moving.at}
        object.__setattr__(self, "_still", still)

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
        transforms = self._moving.transforms(values)
        local = self._still | {index: transforms[..., k, :, :] for k, index in enumerate(self._moving.at)}
        poses: list[NDArray[np.float64]] = []
        for index, joint in enumerate(self.joints):
            poses.append(local[index] if joint.parent < 0 else poses[joint.parent] @ local[index])
        out = np.empty((*values.shape[:-1], len(selected), 4, 4))
        for column, index in enumerate(selected):
            out[..., column, :, :] = np.eye(4) if index < 0 else poses[index]
        return out

    def forward_with_derivatives(
        self, joints: NDArray[np.float64], selected: Sequence[int]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Compute the poses of selected links as `forward`, and their derivatives (..., J, len(selected), 4, 4)."""
        transforms, changes = self._moving.transforms(joints), self._moving.derivatives(joints)
        place = {index: k for k, index in enumerate(self._moving.at)}
        count = joints.shape[-1]
        poses: list[NDArray[np.float64]] = []
        derivatives: list[NDArray[np.float64]] = []
        for index, joint in enumerate(self.joints):
            k = place.get(index)
            local = self._still[index] if k is None else transforms[..., k, :, :]
            above = np.eye(4) if joint.parent < 0 else poses[joint.parent]
            by_joints = np.zeros((*joints.shape[:-1], count, 4, 4))
            if joint.parent >= 0:
                np.matmul(derivatives[joint.parent], local[..., None, :, :], out=by_joints)
            if k is not None:
                by_joints[..., self._moving.driver[k], :, :] += above @ changes[..., k, :, :]
            poses.append(above @ local)
            derivatives.append(by_joints)
        out = np.empty((*joints.shape[:-1], len(selected), 4, 4))
        slopes = np.zeros((*joints.shape[:-1], count, len(selected), 4, 4))
        for column, index in enumerate(selected):
            out[..., column, :, :] = np.eye(4) if index < 0 else poses[index]
            if index >= 0:
                slopes[..., column, :, :] = derivatives[index]
        return out, slopes

    def path(self, index: int) -> list[int]:
        """List the indices of the joints from the root link to one joint, inclusive."""
        path: list[int] = []
        while index >= 0:
            path.append(index)
            index = self.joints[index].parent
        return path[::-1]
