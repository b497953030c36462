"""Stereo session folders: the files of both eyes, missing views, and the rig."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.stereo_sessions import CAMERA, RIGHT_FROM_LEFT, camera_info, make_stereo_session

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import read_frame, read_frame_image
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.silhouette import Body


@pytest.fixture
def folder(tmp_path: Path, bundled_body: Body) -> Path:
    return make_stereo_session(tmp_path / "session", bundled_body)


def test_frames_have_the_files_of_both_views(folder: Path) -> None:
    session = read_session(folder)
    assert session.rig.names == session.view_names == ("left", "right")
    assert (session.camera.fx, session.camera.width) == (CAMERA.fx, CAMERA.width)
    np.testing.assert_allclose(session.rig.view("right").view_from_camera, RIGHT_FROM_LEFT)
    first = session.frames[0]
    assert first.mask == folder / "masks" / "left" / "0000.png"
    assert first.others["right"].mask == folder / "masks" / "right" / "0000.png"
    left, right = read_frame(first, session.rig).views
    assert left.mask.any()
    assert right.mask.any()
    assert (left.mask != right.mask).any()


def test_session_of_one_camera_is_a_rig_of_one_view() -> None:
    session = read_session(bundled_path("demo"))
    assert (session.rig.names, session.view_names) == (("left",), (".",))
    files = session.frames[0]
    (view,) = read_frame(files, session.rig).views
    of_camera = read_frame(files, session.camera)
    np.testing.assert_array_equal(view.mask, of_camera.mask)
    assert view.camera == of_camera.camera == session.camera


def test_frame_of_one_view_has_an_empty_mask_in_the_other(folder: Path) -> None:
    (folder / "masks" / "left" / "0001.png").unlink()
    session = read_session(folder)
    assert [frame.name for frame in session.frames] == ["0000", "0001"]
    left, right = read_frame(session.frames[1], session.rig).views
    assert not left.mask.any()
    assert right.mask.any()


def test_images_of_both_views_are_read_where_there_is_no_mask(folder: Path) -> None:
    (folder / "masks").rename(folder / "images")
    session = read_session(folder)
    data = read_frame_image(session.frames[0], session.rig)
    assert [(view.name, view.image is not None, view.given) for view in data.views] == [
        ("left", True, False),
        ("right", True, False),
    ]


def test_frame_that_is_empty_in_both_views_is_refused(folder: Path) -> None:
    import cv2

    for side in ("left", "right"):
        blank = cv2.imencode(".png", np.zeros((120, 160), np.uint8))[1].tobytes()
        (folder / "masks" / side / "0000.png").write_bytes(blank)
    session = read_session(folder)
    with pytest.raises(InputError, match=r"left/0000.png, .*right/0000.png: mask is empty: .* at least one view"):
        read_frame(session.frames[0], session.rig)


def test_camera_files_may_lie_elsewhere(folder: Path, tmp_path: Path) -> None:
    for side in ("left", "right"):
        shutil.move(folder / f"{side}.yaml", tmp_path / f"{side}_eye.yaml")
    session = read_session(folder, camera=tmp_path / "left_eye.yaml", camera_right=tmp_path / "right_eye.yaml")
    assert session.rig.names == ("left", "right")
    with pytest.raises(InputError, match=r"camera\.yaml"):
        read_session(folder)


def test_exchanged_camera_files_are_refused(folder: Path) -> None:
    (folder / "left.yaml").write_text(yaml.safe_dump(camera_info(0.0053)), encoding="utf-8")
    with pytest.raises(InputError, match=r"left\.yaml: projection_matrix: .*left and right are exchanged"):
        read_session(folder)


def test_right_camera_needs_a_session_of_two_views(folder: Path) -> None:
    shutil.rmtree(folder / "masks" / "right")
    for path in (folder / "masks" / "left").iterdir():
        shutil.move(path, folder / "masks" / path.name)
    (folder / "masks" / "left").rmdir()
    with pytest.raises(InputError, match=r"expected a stereo session \(masks/left\) with a right camera"):
        read_session(folder, camera=folder / "left.yaml", camera_right=folder / "right.yaml")
