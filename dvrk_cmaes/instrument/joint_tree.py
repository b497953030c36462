"""Selection of the joints below the root link of a URDF, and of the independent ones among them.

An independent joint is neither fixed nor a mimic joint, and moves geometry below the root link, itself or through
joints that mimic it. The value of every other moving joint is multiplier * (value of an independent joint) + offset.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.kinematics import Joint, Motion

_WIDEST = 1e3  # rad or m, of limits, origins and mimic relations
_MOTIONS: dict[str, Motion] = {
    "fixed": "fixed",
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}


def joints_below(robot: Any, root: str, path: Path) -> list[Any]:
    """List the joints below a link, parents before children, siblings in the file's order.

    Raises
    ------
    InputError
        A name is used twice, a joint refers to a link that does not exist, a link has two parents, or the joints form
        a loop.
    """
    links = [link.name for link in robot.links]
    for kind, names in (("link", links), ("joint", [joint.name for joint in robot.joints])):
        doubled = sorted({str(name) for name in names if names.count(name) > 1})
        if doubled:
            raise InputError(f"{path}: {kind} {doubled[0]!r}: expected a name used once, got it twice")
    children: dict[str, list[Any]] = {}
    parent_of: dict[str, str] = {}
    for joint in robot.joints:
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise InputError(f"{path}: joint {joint.name!r}: {end} link {link!r} does not exist")
        if joint.child in parent_of:
            raise InputError(f"{path}: link {joint.child!r}: expected one joint above it, got two")
        parent_of[joint.child] = joint.parent
        children.setdefault(joint.parent, []).append(joint)
    below: list[Any] = []
    stack = list(reversed(children.get(root, [])))
    while stack:
        joint = stack.pop()
        if joint.child == root:
            raise InputError(f"{path}: link {root!r}: expected a tree of links, got a loop through it")
        below.append(joint)
        stack.extend(reversed(children.get(joint.child, [])))
    return below


def build_joints(
    robot: Any, tree: list[Any], root: str, with_geometry: set[str], path: Path
) -> tuple[tuple[Joint, ...], tuple[str, ...], Float64]:
    """Build the joints between the root link and the links with geometry.

    Parameters
    ----------
    robot
        yourdfpy's ``Robot``.
    tree
        Joints below the root link, as returned by `joints_below`.
    root
        Name of the root link.
    with_geometry
        Names of the links that have geometry.
    path
        Path of the URDF, for messages.

    Returns
    -------
    joints, joint_names, limits
        The joints, the names of the J independent ones, and their limits (J, 2), rad or m.
    """
    above = {joint.child: joint for joint in tree}
    needed: set[str] = set()
    for link in with_geometry:
        while link != root and above[link].name not in needed:
            needed.add(above[link].name)
            link = above[link].parent
    relevant = [joint for joint in tree if joint.name in needed]
    relations = {joint.name: _mimic_relation(robot, joint, path) for joint in relevant}

    drivers = {driver for driver, multiplier, _ in relations.values() if driver is not None and multiplier != 0.0}
    order = [joint.name for joint in tree] + [joint.name for joint in robot.joints]
    joint_names = tuple(dict.fromkeys(name for name in order if name in drivers))
    by_name = {joint.name: joint for joint in robot.joints}
    limits = np.array([_limits(by_name[name], path) for name in joint_names], dtype=np.float64).reshape(-1, 2)

    index_of = {root: -1}
    joints: list[Joint] = []
    for joint in relevant:
        driver, multiplier, offset = relations[joint.name]
        column = joint_names.index(driver) if driver in joint_names else None
        index_of[joint.child] = len(joints)
        parent, place = index_of[joint.parent], (_origin(joint, path), _axis(joint, path))
        joints.append(Joint(joint.name, joint.child, parent, _MOTIONS[joint.type], *place, column, multiplier, offset))
    return tuple(joints), joint_names, limits


def _mimic_relation(robot: Any, joint: Any, path: Path) -> tuple[str | None, float, float]:
    """Return the independent joint, multiplier and offset that give a joint's value; mimic chains are followed."""
    by_name = {other.name: other for other in robot.joints}
    multiplier, offset, visited = 1.0, 0.0, [joint.name]
    while True:
        if joint.type not in _MOTIONS:
            raise InputError(
                f"{path}: joint {joint.name!r}: type {joint.type!r} is not supported; expected {', '.join(_MOTIONS)}"
            )
        if joint.type == "fixed":
            return None, 0.0, offset
        if joint.mimic is None:
            return joint.name, multiplier, offset
        target_multiplier, target_offset = float(joint.mimic.multiplier), float(joint.mimic.offset)
        if not (np.abs([target_multiplier, target_offset]) <= _WIDEST).all():
            raise InputError(
                f"{path}: joint {joint.name!r}: mimic: expected a finite multiplier and offset, at most {_WIDEST:g}"
            )
        multiplier, offset = multiplier * target_multiplier, offset + multiplier * target_offset
        target = joint.mimic.joint
        if target not in by_name:
            raise InputError(f"{path}: joint {joint.name!r}: mimic: joint {target!r} does not exist")
        if target in visited:
            raise InputError(f"{path}: joint {joint.name!r}: mimic: expected an end, got a loop through {target!r}")
        visited.append(target)
        joint = by_name[target]


def _origin(joint: Any, path: Path) -> Float64:
    origin = np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64)
    if not (np.abs(origin) <= _WIDEST).all():
        raise InputError(f"{path}: joint {joint.name!r}: origin: expected finite numbers, at most {_WIDEST:g} m")
    return origin


def _axis(joint: Any, path: Path) -> Float64:
    """Return the axis (3,) of a joint: normalised for a revolute joint, as stated for a prismatic one (as yourdfpy)."""
    axis = np.asarray(joint.axis, dtype=np.float64)
    if joint.type == "fixed":
        return np.array([1.0, 0.0, 0.0])
    length = float(np.linalg.norm(axis)) if axis.shape == (3,) else float("nan")
    if not np.isfinite(length) or length == 0.0:
        raise InputError(f"{path}: joint {joint.name!r}: axis: expected three finite numbers, not all zero")
    return axis if joint.type == "prismatic" else axis / length


def _limits(joint: Any, path: Path) -> tuple[float, float]:
    if joint.type == "continuous":
        return -np.pi, np.pi
    limit = joint.limit
    lower, upper = (None, None) if limit is None else (limit.lower, limit.upper)
    if lower is None or upper is None:
        raise InputError(f"{path}: joint {joint.name!r}: limit: expected lower and upper")
    if not np.isfinite([lower, upper]).all() or lower > upper:
        raise InputError(
            f"{path}: joint {joint.name!r}: limit: expected finite lower <= upper, got {lower:g} and {upper:g}"
        )
    if max(-lower, upper) > _WIDEST:
        raise InputError(
            f"{path}: joint {joint.name!r}: limit: expected at most {_WIDEST:g}, got {lower:g} and {upper:g}"
        )
    return float(lower), float(upper)
