"""Comparison of an instrument's surface with that of its mirror twin (see `Instrument.twin`)."""

from __future__ import annotations

import numpy as np

from dvrk_cmaes.geometry import Float64, apply
from dvrk_cmaes.instrument.model import TWIN_JOINTS, Instrument

_QUERIES = 10_000  # points whose distance to the other surface is computed
_TARGETS = 60_000  # points sampled on each surface, about 0.1 mm apart
_TOLERANCE = 0.5e-3  # m
_PERCENTILE = 95.0


def twin_distance(instrument: Instrument) -> float:
    """Compute the 95th percentile of the distance between the wrist and jaw surfaces of a pose and its twin, m.

    The pose has a bent wrist and open jaws. Both surfaces are sampled uniformly beyond the shaft's straight part. The
    distances are those from samples to the nearest sample of the other surface, in both directions.
    """
    from scipy.spatial import cKDTree

    joints = instrument.limits @ np.array([0.35, 0.65])
    half_turn, mirrored = instrument.twin(np.eye(4), joints)
    pose_points = _surface(instrument, joints)
    twin_points = apply(half_turn, _surface(instrument, mirrored))
    # for so few queries, trees that are built quickly
    twin_tree, pose_tree = (
        cKDTree(points, compact_nodes=False, balanced_tree=False) for points in (twin_points, pose_points)
    )
    to_twin, _ = twin_tree.query(pose_points[:_QUERIES])
    to_pose, _ = pose_tree.query(twin_points[:_QUERIES])
    return float(np.percentile(np.concatenate([to_twin, to_pose]), _PERCENTILE))


def resembles_twin(instrument: Instrument) -> bool:
    """Whether the instrument has the twin's joints and its surface is within half a millimetre of the twin's."""
    return all(name in instrument.joint_names for name in TWIN_JOINTS) and twin_distance(instrument) < _TOLERANCE


def _surface(instrument: Instrument, joints: Float64) -> Float64:
    """Sample points (N, 3) uniformly on wrist and jaws in the root link's frame; they are the same for all joints."""
    import trimesh

    poses = instrument.forward(joints)
    closed = instrument.forward(np.zeros_like(joints))
    corners: list[Float64] = []
    for link, pose, zero in zip(instrument.links, poses, closed, strict=True):
        triangles = link.vertices[link.faces]
        if instrument.shaft is not None:
            along = apply(zero, triangles) @ instrument.shaft.direction
            triangles = triangles[along.max(axis=1) > instrument.shaft.distal_end + 1e-6]
        corners.append(apply(pose, triangles))
    points = np.concatenate(corners).reshape(-1, 3)
    mesh = trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, _TARGETS, seed=0)[0])
