"""Rigid instruments of given meshes and poses for the tests of the renderer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from dvrk_cmaes import Instrument
from dvrk_cmaes.instrument import Chain, Joint, Link


def rigid_instrument(*meshes: trimesh.Trimesh, poses: Sequence[np.ndarray] = ()) -> Instrument:
    """Give an instrument without moving joints, one link a mesh, at root_from_link poses (all the root's if none)."""
    poses = poses or [np.eye(4)] * len(meshes)
    names = [f"link_{i}" for i in range(len(meshes))]
    joints = tuple(
        Joint(f"to_{name}", name, -1, "fixed", pose, np.array([0.0, 0.0, 1.0]))
        for name, pose in zip(names, poses, strict=True)
    )
    links = tuple(
        Link(name, np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32))
        for name, mesh in zip(names, meshes, strict=True)
    )
    return Instrument(
        name="by hand",
        root_link="root",
        links=links,
        joint_names=(),
        limits=np.zeros((0, 2)),
        shaft=None,
        jaw_tips=(),
        chain=Chain(joints),
        link_joints=tuple(range(len(links))),
    )


def surface(vertices: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]) -> trimesh.Trimesh:
    """Give a mesh of vertices in millimetres, without merging or reordering."""
    return trimesh.Trimesh(np.array(vertices, dtype=float) * 1e-3, np.array(faces), process=False)
