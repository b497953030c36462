"""Session folders: files are assigned to frames by name, and every wrong file is named."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.places import bundled_path

from dvrk_cmaes import InputError, read_session
from dvrk_cmaes.frames.keypoints import read_keypoints
from dvrk_cmaes.frames.truth import SessionTruth, read_golden, write_golden

DEMO = bundled_path("demo")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copy the demo session, to be damaged."""
    return Path(shutil.copytree(DEMO, tmp_path / "session"))


def message(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_session(folder)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_times_of_images_are_those_of_frames(folder: Path) -> None:
    (folder / "images.csv").write_text("frame,time\n0000,1.5\n0002,1755000000250\n")
    times = [frame.time for frame in read_session(folder).frames]
    assert times == [1.5, None, 1755000000.25, None, None]


@pytest.mark.parametrize("tips", [1, 2])
def test_golden_tips_are_one_or_two(folder: Path, tips: int) -> None:
    truth = read_golden(folder / "golden.json")
    frame = truth.frames["0000"]
    assert frame.tips is not None
    write_golden(folder / "golden.json", SessionTruth({"0000": replace(frame, tips=frame.tips[:tips])}))
    again = read_golden(folder / "golden.json").frames["0000"].tips
    np.testing.assert_allclose(again, frame.tips[:tips], atol=1e-9)


def test_two_masks_of_one_frame_are_refused(folder: Path) -> None:
    shutil.copy(folder / "masks" / "0000.png", folder / "masks" / "0000.jpg")
    assert "expected one file for frame 0000" in message(folder)


def test_keypoints_are_read_by_frame(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.csv"
    path.write_text("frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n7, 1,2 ,3,4\n")
    found = read_keypoints(path)
    np.testing.assert_array_equal(found["7"], [[1, 2], [3, 4]])
