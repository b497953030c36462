"""scripts/accuracy.py image-sizes: where the tools are drawn, and what the rows count."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from dvrk_cmaes.io.bundled import bundled_path

if TYPE_CHECKING:
    from measure.cases import Case

pytestmark = pytest.mark.usefixtures("scripts_on_path")


@pytest.mark.parametrize("size", [(1280, 1024), (1920, 1080), (160, 120)])
def test_camera_of_another_size_shows_the_same_scene(cases: list[Case], size: tuple[int, int]) -> None:
    from measure.accuracy.image_sizes import camera_of

    camera, other = cases[0].camera, camera_of(cases[0], size)
    scale = min(size[0] / 640, size[1] / 480)
    middle = other.project([0.01, -0.02, 0.1]) + 0.5 - np.array(size) / 2
    np.testing.assert_allclose(middle, (camera.project([0.01, -0.02, 0.1]) + 0.5 - [320, 240]) * scale, atol=1e-9)
    assert other.fx / camera.fx == pytest.approx(scale)


def test_tools_cover_shares_of_the_image_as_asked(cases: list[Case]) -> None:
    from measure.accuracy.image_sizes import camera_of, drawn, placed
    from measure.cases import Measurement

    given = Measurement([str(bundled_path("demo"))])
    camera = camera_of(cases[0], (320, 256))
    shares = []
    for number in range(8):
        pose = placed(given, cases[0], camera, np.random.default_rng(number))
        shares.append(float(drawn(given, cases[0], camera, pose, "x").mask.mean()))
    assert 0.0005 < min(shares) < 0.02
    assert 0.05 < max(shares) < 0.75


def test_rows_count_masks_that_have_no_result(cases: list[Case], tasks_in_a_thread: None) -> None:
    from measure.accuracy import image_sizes
    from measure.cases import Measurement

    given = Measurement([str(bundled_path("demo"))], frames=2, workers=1)
    row = image_sizes._results(given, cases, (142, 113))
    assert (row["masks"], row["errors"], row["first_error"]) == (2, 0, None)
