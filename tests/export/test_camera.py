"""Cameras and rigs that a calibration used, written in the formats of camera files and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.commands import main
from helpers.files import write_json
from helpers.page_calibrations import calibration, solved
from helpers.transforms import transform

from dvrk_cmaes import Camera, Rig, read_calibration
from dvrk_cmaes.camera.files import read_camera_file
from dvrk_cmaes.camera.rig import ViewDocument
from dvrk_cmaes.camera.rig_files import read_rig

LENSES = {
    "pinhole": Camera(640, 480, 893.8, 901.25, 318.5, 241.125),
    "plumb_bob": Camera(640, 480, 893.8, 901.25, 318.5, 241.125, (-0.2, 0.05, 0.001, -0.002, 0.01)),
    "rational": Camera(
        640, 480, 893.8, 901.25, 318.5, 241.125, (0.1, 0.02, 1e-3, 1e-3, 0.0, 0.3, 0.04, 0.001), "rational_polynomial"
    ),
    "fisheye": Camera(640, 480, 893.8, 901.25, 318.5, 241.125, (0.01, -0.002, 0.001, 0.0), "equidistant"),
}
TURN = np.deg2rad([0.1, 0.35, -0.3])


def rig_of(camera: Camera) -> Rig:
    """A stereo pair whose right eye is turned against its file, and of another focal length than the left one."""
    file = Rig.stereo(camera, camera.changed(0.97, (0.0, 0.0)), transform(np.eye(3), [-0.0053, 0.0001, 0.0]))
    return Rig((file.views[0], file.views[1].turned(TURN)))


def exported(folder: Path, rig: Rig, capsys: pytest.CaptureFixture[str]) -> Path:
    """Export the cameras of a calibration that used a rig; returns the folder of the files."""
    used = tuple(ViewDocument.of(view) for view in rig.views)
    write_json(folder / "session.json", replace(calibration(solved(("a", "b"))), views=used).to_dict())
    assert main(["export", str(folder / "session.json"), "--to", "camera", "--out", str(folder / "out")]) == 0
    capsys.readouterr()
    return folder / "out"


def check_same(found: Rig, rig: Rig) -> None:
    for read, used in zip(found.views, rig.views, strict=True):
        assert (read.camera.width, read.camera.height) == (used.camera.width, used.camera.height)
        np.testing.assert_allclose(read.camera.matrix, used.camera.matrix, atol=1e-6)
        np.testing.assert_allclose(read.view_from_camera, used.view_from_camera, atol=2e-9)
        pixels = np.array([[0.0, 0.0], [639.0, 479.0], [100.0, 400.0]])
        np.testing.assert_allclose(read.camera.normalise(pixels), used.camera.normalise(pixels), atol=1e-7)


@pytest.mark.parametrize("lens", LENSES)
def test_rig_is_read_back_from_each_format(lens: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = rig_of(LENSES[lens])
    out = exported(tmp_path, rig, capsys)
    check_same(read_rig(out / "ros" / "left.yaml", out / "ros" / "right.yaml").rig, rig)
    check_same(read_rig(out / "opencv" / "stereo.xml").rig, rig)
    plain = out / "plain"
    if lens == "fisheye":
        assert not plain.exists()
    else:
        check_same(read_rig(plain / "left.yaml", plain / "right.yaml", size=(640, 480)).rig, rig)


@pytest.mark.parametrize("lens", LENSES)
def test_single_camera_is_read_back(lens: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = LENSES[lens]
    out = exported(tmp_path, Rig.of_camera(camera), capsys)
    names = ["ros/camera.yaml", "opencv/camera.xml", *([] if lens == "fisheye" else ["plain/camera.yaml"])]
    written = sorted(path.relative_to(out).as_posix() for path in out.rglob("[!.]*.*"))
    assert written == sorted([*names, "run.json"])
    for name in names:
        found = read_camera_file(out / name, size=(640, 480)).camera
        check_same(Rig.of_camera(found), Rig.of_camera(camera))


def test_opencv_reads_the_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = rig_of(LENSES["plumb_bob"])
    out = exported(tmp_path, rig, capsys)
    storage = cv2.FileStorage(str(out / "opencv" / "stereo.xml"), cv2.FILE_STORAGE_READ)
    place = rig.views[1].view_from_camera
    np.testing.assert_allclose(storage.getNode("M2").mat(), rig.views[1].camera.matrix, atol=1e-6)
    np.testing.assert_allclose(storage.getNode("D1").mat().ravel(), rig.views[0].camera.distortion, atol=1e-9)
    np.testing.assert_allclose(storage.getNode("R").mat(), place[:3, :3], atol=2e-9)
    np.testing.assert_allclose(storage.getNode("T").mat().ravel(), place[:3, 3], atol=2e-9)
    assert storage.getNode("image_width").real() == 640


def test_calibration_keeps_its_cameras(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = rig_of(LENSES["rational"])
    exported(tmp_path, rig, capsys)
    check_same(Rig(tuple(view.restored() for view in read_calibration(tmp_path / "session.json").views)), rig)


def test_calibration_without_cameras_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_json(tmp_path / "session.json", calibration(solved(("a", "b"))).to_dict())
    assert main(["export", str(tmp_path / "session.json"), "--to", "camera", "--out", str(tmp_path / "out")]) == 2
    assert "session.json: views: expected the cameras that were used, got none" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
