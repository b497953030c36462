"""Recordings for the Rerun viewer: entities, timelines, values, and what is missing."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.moving_worlds import SMALL
from helpers.track_rows import row
from helpers.transforms import exp_rotation, inverse, transform
from rerun.chunk import RrdReader

from dvrk_cmaes import Body, DvrkCmaesError, InputError, Rig
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
    rows = [row(0), row(1, "gone", "no mask"), row(2, "doubtful", "uncertain: x")]
    with rerun_file(path, SMALL, bundled_body.instrument, "made") as log:
        log.add(0, rows[0], {"jaw": 0.5}, [TrackView(image, mask, mask, SIZE)])
        log.add(1, rows[1], {"jaw": 0.6}, [TrackView(None, None, None, SIZE)])
        log.add(2, rows[2], {"jaw": np.nan}, [TrackView(None, mask, mask, SIZE)])
    assert [entry.name for entry in path.parent.iterdir()] == ["recording.rrd"]
    return Recording(path)


def test_camera_and_meshes_are_there_once(recording: Recording, bundled_body: Body) -> None:
    links = {f"/instrument/{link.name}" for link in bundled_body.instrument.links}
    assert recording.entities(static=True) == {"/", "/camera", "/status", *links}
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


def test_joints_are_curves_in_degrees_with_gaps(recording: Recording) -> None:
    found = [value for value in recording.column("/joints/jaw/found", "Scalars:scalars") if value]
    read = [value for value in recording.column("/joints/jaw/read", "Scalars:scalars") if value]
    np.testing.assert_allclose(np.ravel(found), np.degrees([0.2, 0.22]))
    np.testing.assert_allclose(np.ravel(read), np.degrees([0.5, 0.6]))
    assert len(recording.column("/joints/jaw/found", "frame")) == 3
    np.testing.assert_allclose(np.ravel(recording.column("/offsets/roll", "Scalars:scalars")), np.degrees([0.05, 0.05]))


def test_links_have_their_poses_and_are_hidden_without_one(recording: Recording, bundled_body: Body) -> None:
    places = [value for value in recording.column("/instrument", "Transform3D:translation") if value]
    np.testing.assert_allclose(np.reshape(places, (-1, 3)), [[0, 0, 0.1], [0.002, 0, 0.1]], atol=1e-7)
    scales = [value for value in recording.column("/instrument", "Transform3D:scale") if value]
    np.testing.assert_allclose(np.ravel(scales), 0)
    joints = [row(0)["joints"][name] for name in bundled_body.instrument.joint_names]
    for link, pose in zip(bundled_body.instrument.links, bundled_body.instrument.forward(joints), strict=True):
        turned = recording.column(f"/instrument/{link.name}", "Transform3D:mat3x3")[0]
        np.testing.assert_allclose(np.reshape(turned, (3, 3)).T, pose[:3, :3], atol=1e-6)


def test_images_and_masks_are_pictures(recording: Recording, image: np.ndarray, mask: np.ndarray) -> None:
    def decoded(entity: str, number: int) -> np.ndarray:
        blobs = [value for value in recording.column(entity, "EncodedImage:blob") if value]
        return cv2.imdecode(np.array(blobs[number][0], np.uint8), cv2.IMREAD_UNCHANGED)

    assert np.abs(decoded("/camera/image", 0).astype(int) - image).max() < 6
    for number in (0, 1):  # of the first and the third frame
        seen = decoded("/camera/mask", number)
        np.testing.assert_array_equal(seen[..., 3] > 0, mask)
    strips = recording.column("/camera/outline", "LineStrips2D:strips")
    corners = np.array(strips[0][0])
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[60.5, 40.5], [199.5, 119.5]])


def test_status_and_reasons_are_told(recording: Recording) -> None:
    assert np.ravel(recording.column("/status", "StateChange:state")).tolist() == ["ok", "gone", "doubtful"]
    told = np.ravel(recording.column("/reasons", "TextLog:text")).tolist()
    (colours,) = recording.column("/status", "StateConfiguration:values", static=True)
    assert {"ok", "doubtful", "lost", "gone"} == set(colours)
    assert told == ["0000: ok", "0001: gone; no mask", "0002: doubtful; uncertain: x"]


def test_frames_without_times_have_numbers_only(bundled_body: Body, tmp_path: Path) -> None:
    with rerun_file(tmp_path / "a.rrd", SMALL, bundled_body.instrument, "made") as log:
        log.add(0, row(0, time=None), {}, [TrackView(None, None, None, SIZE)])
    names = {name for chunk in Recording(tmp_path / "a.rrd").chunks for name in chunk.timeline_names}
    assert names == {"frame"}


def test_each_view_of_a_rig_has_its_camera_and_pictures(bundled_body: Body, mask: np.ndarray, tmp_path: Path) -> None:
    right = replace(SMALL, cx=SMALL.cx + 3)
    right_from_left = transform(exp_rotation([0.01, -0.02, 0.0]), [-0.005, 0.0, 0.0])
    moved = np.roll(mask, 20, axis=1)
    with rerun_file(
        tmp_path / "a.rrd", Rig.stereo(SMALL, right, right_from_left), bundled_body.instrument, "made"
    ) as log:
        log.add(0, row(0), {}, [TrackView(None, mask, mask, SIZE), TrackView(None, moved, moved, SIZE)])
    found = Recording(tmp_path / "a.rrd")
    assert {"/camera", "/camera_right"} <= found.entities(static=True)
    (place,) = found.column("/camera_right", "Transform3D:translation", static=True)
    np.testing.assert_allclose(np.ravel(place), inverse(right_from_left)[:3, 3], atol=1e-7)
    (matrix,) = found.column("/camera_right", "Pinhole:image_from_camera", static=True)
    np.testing.assert_allclose(np.reshape(matrix, (3, 3)).T[0, 2], right.cx + 0.5)
    ((strip,),) = found.column("/camera_right/outline", "LineStrips2D:strips")
    np.testing.assert_allclose(np.min(strip, axis=0), [80.5, 40.5])


def test_nothing_is_left_after_an_error(bundled_body: Body, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="broken"), rerun_file(tmp_path / "a.rrd", SMALL, bundled_body.instrument, "s"):
        raise InputError("broken")
    assert list(tmp_path.iterdir()) == []


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
    with pytest.raises(DvrkCmaesError) as caught:
        check_rerun("--rerun", Path("a.rrd"))
    assert str(caught.value) == "--rerun needs rerun-sdk: pip install '.[viewer]'"
