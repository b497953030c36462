"""What is used of a session that is followed."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
from helpers.places import bundled_path

from dvrk_cmaes import read_session
from dvrk_cmaes.runs.track_inputs import used_session

DEMO = bundled_path("demo")


def test_cameras_of_a_recording_have_the_size_of_its_masks(tmp_path: Path) -> None:
    shutil.copy(DEMO / "camera.yaml", tmp_path)
    (tmp_path / "masks").mkdir()
    for path in (DEMO / "masks").iterdir():
        half = cv2.resize(cv2.imread(str(path)), (320, 240), interpolation=cv2.INTER_NEAREST)
        cv2.imwrite(str(tmp_path / "masks" / path.name), half)
    used, evidence = used_session(read_session(tmp_path), None)
    assert (evidence, used.camera.width) == ("masks", 320)
    assert "the mask is 320 x 240, the calibration 640 x 480: intrinsics rescaled by 0.5" in used.notes
