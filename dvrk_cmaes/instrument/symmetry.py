"""Whether an instrument looks the same as its mirror twin (see `Instrument.twin`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.geometry import apply
from dvrk_cmaes.instrument.model import TWIN_JOINTS, Instrument

_QUERIES = 10_000  # points whose distance is measured
_TARGETS = 60_000  # points they are measured to: some 0.1 mm apart
_TOLERANCE = 0.5e-3  # m
_PERCENTILE = 95.0


def twin_distance(instrument: Instrument) -> float:
    """Distance between the surfaces of wrist and jaws and those of the twin: its 95th percentile, m.

    Both are sampled evenly, beyond the shaft's straight part, in a bent pose with open jaws; the distance is
    from each sample to the nearest of the other surface, in both directions.
    """
    from scipy.spatial import cKDTree

    joints = instrument.limits @ np.array([0.35, 0.65])
    half_turn, mirrored = instrument.twin(np.eye(4), joints)
    own = _surface(instrument, joints)
    other = apply(half_turn, _surface(instrument, mirrored))
    there, _ = cKDTree(other).query(own[:_QUERIES])
    back, _ = cKDTree(own).query(other[:_QUERIES])
    return float(np.percentile(np.concatenate([there, back]), _PERCENTILE))


def looks_like_its_twin(instrument: Instrument) -> bool:
    """Whether the twin differs in joints and hardly in shape: it has a wrist, and lies within half a millimetre."""
    return all(name in instrument.joint_names for name in TWIN_JOINTS) and twin_distance(instrument) < _TOLERANCE


def _surface(instrument: Instrument, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 3) spread evenly over wrist and jaws, in the root link's frame; the same ones for all joints."""
    poses = instrument.forward(joints)
    closed = instrument.forward(np.zeros_like(joints))
    corners: list[NDArray[np.float64]] = []
    for link, pose, zero in zip(instrument.links, poses, closed, strict=True):
        triangles = link.vertices[link.faces]
        if instrument.shaft is not None:
            along = apply(zero, triangles) @ instrument.shaft.direction
            triangles = triangles[along.max(axis=1) > instrument.shaft.distal_end + 1e-6]
        corners.append(apply(pose, triangles))
    a, b, c = np.moveaxis(np.concatenate(corners), 1, 0)
    total = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    rng = np.random.default_rng(0)
    chosen = np.minimum(np.searchsorted(total, rng.uniform(0, total[-1], _TARGETS)), len(total) - 1)
    first, second = rng.uniform(size=(2, _TARGETS, 1))
    root = np.sqrt(first)  # uniform over a triangle
    return np.asarray((1 - root) * a[chosen] + root * (1 - second) * b[chosen] + root * second * c[chosen])
