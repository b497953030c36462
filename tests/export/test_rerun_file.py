"""Recordings for the Rerun viewer: entities, timelines, values, and what is missing."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.moving_worlds import SMALL
from helpers.track_rows import row
from rerun.chunk import RrdReader

from dvrk_cmaes import Body, InputError
from dvrk_cmaes.export.rerun_file import check_rerun, rerun_file
from dvrk_cmaes.results.tracked import TrackView

SHAPE = (SMALL.height, SMALL.width)
SIZE = (SMALL.width, SMALL.height)


class Recording:
    """What a recording contains, by entity."""

    def __init__(self, path: Path) -> None:
        self.chunks = [chunk for chunk in RrdReader(path).stream().to_chunks() if chunk.entity_path != "/__properties"]

    def entities(self, *, static: bool) -> set[str]:
        return {chunk.entity_path for chunk in self.chunks if chunk.is_static == static}

    def column(self, entity: str, name: str, *, static: bool = False) -> list[Any]:
        """The values of a component or timeline of an entity, in the order of the frames."""
        found = []
        for chunk in self.chunks:
            if (chunk.entity_path, chunk.is_static) == (entity, static):
                batch = chunk.to_record_batch()
                places = range(batch.num_rows) if static else batch.column("frame").to_pylist()
                if name in batch.schema.names:
                    values = batch.column(name)
                    values = values.cast("int64") if name == "time" else values  # ns
                    found += zip(places, values.to_pylist(), strict=True)
        return [value for _, value in sorted(found, key=lambda pair: pair[0])]


@pytest.fixture(scope="module")
def mask() -> np.ndarray:
    drawn = np.zeros(SHAPE, np.bool_)
    drawn[40:120, 60:200] = True
    return drawn


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return np.full((*SHAPE, 3), (30, 60, 160), np.uint8)


@pytest.fixture(scope="module")
def recording(bundled_body: Body, image: np.ndarray, mask: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Three frames: followed, gone, and followed again with a mask alone."""
    path = tmp_path_factory.mktemp("rerun") / "new" / "recording.rrd"
    rows = [row(0), row(1, "lost", "no mask"), row(2, "doubtful", "uncertain: x")]
    with rerun_file(path, SMALL, bundled_body.instrument, "made") as log:
        log.add(0, rows[0], {"jaw": 0.5}, [TrackView(image, mask, mask, SIZE)])
        log.add(1, rows[1], {"jaw": 0.6}, [TrackView(None, None, None, SIZE)])
        log.add(2, rows[2], {"jaw": np.nan}, [TrackView(None, mask, mask, SIZE)])
    assert [entry.name for entry in path.parent.iterdir()] == ["recording.rrd"]
    return Recording(path)


def test_camera_and_meshes_are_there_once(recording: Recording, bundled_body: Body) -> None:
    links = {f"/instrument/{link.name}" for link in bundled_body.instrument.links}
    assert recording.entities(static=True) == {"/", "/camera", *links}
    (matrix,) = recording.column("/camera", "Pinhole:image_from_camera", static=True)
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    np.testing.assert_allclose(np.reshape(matrix, (3, 3)).T, SMALL.matrix + half)
    link = bundled_body.instrument.links[0]
    (vertices,) = recording.column(f"/instrument/{link.name}", "Mesh3D:vertex_positions", static=True)
    np.testing.assert_allclose(vertices, link.vertices, atol=1e-6)


def test_timelines_are_frame_and_time(recording: Recording) -> None:
    assert {name for chunk in recording.chunks for name in chunk.timeline_names} == {"frame", "time"}
    assert recording.column("/camera/outline", "frame") == [0, 1, 2]
    times = 1e-9 * np.array(recording.column("/camera/outline", "time"))
    np.testing.assert_allclose(times, [0, 1 / 30, 2 / 30], atol=1e-8)


def test_links_have_their_poses_and_are_hidden_without_one(recording: Recording, bundled_body: Body) -> None:
    places = [value for value in recording.column("/instrument", "Transform3D:translation") if value]
    np.testing.assert_allclose(np.reshape(places, (-1, 3)), [[0, 0, 0.1], [0.002, 0, 0.1]], atol=1e-7)
    scales = [value for value in recording.column("/instrument", "Transform3D:scale") if value]
    np.testing.assert_allclose(np.ravel(scales), 0)
    joints = [row(0)["joints"][name] for name in bundled_body.instrument.joint_names]
    for link, pose in zip(bundled_body.instrument.links, bundled_body.instrument.forward(joints), strict=True):
        turned = recording.column(f"/instrument/{link.name}", "Transform3D:mat3x3")[0]
        np.testing.assert_allclose(np.reshape(turned, (3, 3)).T, pose[:3, :3], atol=1e-6)


def test_place_that_cannot_be_written_to_is_named(bundled_body: Body, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "a.rrd"
    with (
        pytest.raises(InputError, match="not written") as caught,
        rerun_file(path, SMALL, bundled_body.instrument, "s"),
    ):
        pass
    assert str(path) in str(caught.value)


def test_other_extension_is_refused() -> None:
    with pytest.raises(InputError, match=r"--rerun: expected the name of a file that ends in \.rrd, got 'a\.txt'"):
        check_rerun("--rerun", Path("a.txt"))


def test_missing_library_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError) as caught:
        check_rerun("--rerun", Path("a.rrd"))
    install = f"{sys.executable} -m pip install 'rerun-sdk<0.42,>=0.41'"
    assert str(caught.value) == f"--rerun: needs the library rerun-sdk, which is not installed; run: {install}"
