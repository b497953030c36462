"""Embree scenes of an instrument: one committed scene per link, and rays moved instead of meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument import Instrument

NEAR = 1e-3
"""Metres in front of the eye, along z, where the view begins; nothing nearer is seen."""


def _embree() -> Any:
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError as error:
        raise InputError(
            f"embreex is missing or does not load ({error}): install it with 'pip install \"embreex>=4.4,<5\"'"
        ) from error
    return rtcore_scene.EmbreeScene, TriangleMesh


class LinkScenes:
    """Committed Embree scenes, one a link; safe to query from several threads.

    Scenes cannot be pickled: each process builds its own.
    """

    def __init__(self, instrument: Instrument) -> None:
        scene_type, mesh_type = _embree()
        self._scenes: list[Any] = []
        ray = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
        for link in instrument.links:
            scene = scene_type()
            mesh_type(scene, np.ascontiguousarray(link.vertices[link.faces], dtype=np.float32))
            # The first query commits the scene, without a lock: do it before threads share it.
            scene.run(ray, ray, query="OCCLUDED")
            self._scenes.append(scene)

    def __len__(self) -> int:
        return len(self._scenes)

    def hit(self, link: int, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Whether each ray, (N, 3) in the link's frame, meets the link."""
        if len(origins) == 0:
            return np.zeros(0, dtype=np.bool_)
        found: NDArray[np.int32] = self._scenes[link].run(origins, directions, query="OCCLUDED")
        return np.asarray(found == 0)

    def covered(
        self,
        camera_from_link: NDArray[np.float64],
        pose: NDArray[np.intp],
        directions: NDArray[np.float64],
    ) -> NDArray[np.bool_]:
        """Whether any link covers each viewing direction.

        ``camera_from_link`` is (C, L, 4, 4); ``pose`` (N,) says which of the C poses a ray belongs to; ``directions``
        (N, 3) are in the camera's frame with z = 1. A link that a ray has met is not asked about again.
        """
        result = np.zeros(len(directions), dtype=np.bool_)
        for link in range(len(self)):
            ask = np.flatnonzero(~result)
            rotation = camera_from_link[:, link, :3, :3]
            eye = -np.einsum("cji,cj->ci", rotation, camera_from_link[:, link, :3, 3])
            turned = np.einsum("nji,nj->ni", rotation[pose[ask]], directions[ask])
            origins = eye[pose[ask]] + NEAR * turned
            result[ask] = self.hit(
                link, np.ascontiguousarray(origins, dtype=np.float32), np.ascontiguousarray(turned, dtype=np.float32)
            )
        return result
