"""Embree scenes are built once, when the first ray is traced."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from dvrk_cmaes import Body
from dvrk_cmaes.silhouette.scenes import LinkScenes


def test_scenes_are_built_once_by_all_threads(bundled_body: Body, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[Any] = []
    of_link = LinkScenes.scene_of

    def counted(self: LinkScenes, link: Any) -> Any:
        built.append(link.name)
        return of_link(self, link)

    monkeypatch.setattr(LinkScenes, "scene_of", counted)
    scenes = LinkScenes(bundled_body.instrument)
    assert len(scenes) == len(bundled_body.instrument.links)
    assert not built
    rays = np.tile(np.array([[0.0, 0.0, 1.0]], dtype=np.float32), (4, 1))
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda link: scenes.hit(link % len(scenes), -rays, rays), range(16)))
    assert built == [link.name for link in bundled_body.instrument.links]
    for first, again in zip(found, found[len(scenes) :], strict=False):
        np.testing.assert_array_equal(first, again)


def test_body_of_a_search_builds_none(bundled_body: Body) -> None:
    decimated = bundled_body.decimated(6e-4)
    assert not decimated.scenes._built
