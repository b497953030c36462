"""Public pictures of other laboratories (``../shared/frames/labs``), as their folders are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes import FrameFiles, estimate, load_instrument, read_camera, read_frame, read_session
from dvrk_cmaes.camera.files import read_camera_file
from dvrk_cmaes.camera.rig_files import read_rig
from dvrk_cmaes.frames.field_of_view import IGNORED, outside_view
from dvrk_cmaes.frames.images import read_image, read_mask
from dvrk_cmaes.segment import segment


@pytest.mark.parametrize(("name", "pick"), [("f0", (950, 150)), ("f2", (117, 650))])
def test_needle_driver_of_labels_in_a_grey_border_is_explained(shared: Path, name: str, pick: tuple[int, int]) -> None:
    folder = shared / "frames" / "labs" / "endovis17"
    files = FrameFiles(
        name,
        folder / "labels" / f"{name}.png",
        image=folder / "images" / f"{name}.png",
        label=(10, 20, 30),
        pick=pick,
    )
    data = read_frame(files, read_camera(folder / "camera.yaml"))
    assert IGNORED in data.notes
    assert data.ignore is not None
    result = estimate(data.mask, data.camera, {}, load_instrument("lnd"), ignore=data.ignore)
    assert result.quality is not None
    assert result.quality.iou > 0.95


def test_border_of_a_raw_frame_is_ignored(shared: Path) -> None:
    image = read_image(shared / "frames" / "labs" / "endovis17" / "raw" / "frame000.png")
    outside = outside_view(image)
    picture = np.zeros(outside.shape, np.bool_)
    picture[28 : 28 + 1024, 320 : 320 + 1280] = True
    assert outside[~picture].all()
    assert outside[picture].mean() < 0.04
    half = np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
    assert not (segment(half).mask & outside[::2, ::2]).any()


@pytest.mark.parametrize("level", [0, 15, 90])
@pytest.mark.parametrize("shape", ["bars", "circle", "frame"])
def test_border_of_any_level_and_shape_is_found(level: int, shape: str) -> None:
    rng = np.random.default_rng(level)
    image = rng.integers(100, 200, (240, 320, 3)).astype(np.uint8)
    v, u = np.mgrid[:240, :320]
    border = {
        "bars": (u < 40) | (u >= 280),
        "circle": (u - 160) ** 2 + (v - 120) ** 2 > 130**2,
        "frame": (u < 6) | (u >= 310) | (v < 5) | (v >= 232),
    }[shape]
    image[border] = np.clip(level + rng.integers(-2, 3, (border.sum(), 3)), 0, 255)
    if shape == "bars":
        image[100:108, 8:30] = 250  # a text beside the picture
    outside = outside_view(image)
    assert outside[border].mean() > 0.99
    assert outside[~border].mean() < 0.12


def test_plain_background_is_no_border() -> None:
    image = np.full((240, 320, 3), 235, np.uint8)
    image[:150, 140:180] = np.random.default_rng(0).integers(30, 90, (150, 40, 3))
    assert not outside_view(image).any()


def test_cameras_of_laboratories_are_read(shared: Path) -> None:
    labs = shared / "frames" / "labs"
    endovis = read_rig(labs / "endovis18_camera_calibration_seq2.txt").rig
    assert [round(view.camera.fx, 2) for view in endovis.views] == [1084.21, 1083.43]
    assert endovis.views[1].view_from_camera[0, 3] == pytest.approx(-4.3499e-3)
    lincoln = read_session(labs / "lincoln")
    assert 1e3 * np.linalg.norm(lincoln.rig.views[1].view_from_camera[:3, 3]) == pytest.approx(58.3, abs=0.1)
    assert sum(bool(frame.readings) for frame in lincoln.frames) == len(lincoln.frames) == 24
    assert (
        read_session(labs / "ucsd19").rig.camera.width == read_camera_file(labs / "ucsd19" / "camera.xml").camera.width
    )


def test_colour_of_a_label_image_selects_the_tools(shared: Path) -> None:
    labels = shared / "frames" / "labs" / "jhu" / "labels" / "01335.png"
    assert read_mask(labels, label="#00ff00").sum() == 101298
    assert 30000 < read_mask(labels, label="#00ff00", pick=(300, 160)).sum() < 70000
