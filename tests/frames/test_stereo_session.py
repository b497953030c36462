"""Stereo session folders: the files of both eyes, missing views, and the rig."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.stereo_sessions import make_stereo_session

from dvrk_cmaes import Body, InputError, read_frame, read_session


@pytest.fixture
def folder(tmp_path: Path, bundled_body: Body) -> Path:
    return make_stereo_session(tmp_path / "session", bundled_body)


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
    data = read_frame(session.frames[0], session.rig)
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


def test_right_camera_needs_a_session_of_two_views(folder: Path) -> None:
    shutil.rmtree(folder / "masks" / "right")
    for path in (folder / "masks" / "left").iterdir():
        shutil.move(path, folder / "masks" / path.name)
    (folder / "masks" / "left").rmdir()
    with pytest.raises(InputError, match=r"expected a stereo session \(masks/left\) with a right camera"):
        read_session(folder, camera=folder / "left.yaml", camera_right=folder / "right.yaml")
