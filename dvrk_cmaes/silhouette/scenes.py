"""Embree scenes of an instrument: one scene per link, in whose frame the rays are traced."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.instrument import Instrument

NEAR = 1e-3
"""Depth of the near plane, m along the optical axis: surfaces in front of it are not rendered."""


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
    """Embree scenes, one for each link; may be queried from several threads at once.

    Scenes cannot be pickled: each process builds its own.
    """

    def __init__(self, instrument: Instrument) -> None:
        scene_type, mesh_type = _embree()
        self._scenes: list[Any] = []
        ray = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
        for link in instrument.links:
            scene = scene_type()
            mesh_type(scene, np.ascontiguousarray(link.vertices[link.faces], dtype=np.float32))
            # The first query commits the scene without a lock, so it is made before threads share the scene.
            scene.run(ray, ray, query="OCCLUDED")
            self._scenes.append(scene)

    def __len__(self) -> int:
        return len(self._scenes)

    def hit(self, link: int, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether each ray, (N, 3) in the link's frame, hits the link, (N,)."""
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
        """Return whether any link covers each viewing direction, (N,).

        ``camera_from_link`` is (C, L, 4, 4); ``pose`` (N,) is the index of the pose of each ray; ``directions`` (N, 3)
        are in the camera's frame with z = 1. A ray that has hit one link is not traced against the others.
        """
        result = np.zeros(len(directions), dtype=np.bool_)
        for link in range(len(self)):
            rest = np.flatnonzero(~result)
            rotation = camera_from_link[:, link, :3, :3]
            centre = -np.einsum("cji,cj->ci", rotation, camera_from_link[:, link, :3, 3])
            turned = np.einsum("nji,nj->ni", rotation[pose[rest]], directions[rest])
            origins = centre[pose[rest]] + NEAR * turned
            result[rest] = self.hit(
                link, np.ascontiguousarray(origins, dtype=np.float32), np.ascontiguousarray(turned, dtype=np.float32)
            )
        return result
