"""Motion of outline points in the image with pose and joints."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.placed_points import placed_points
from helpers.transforms import lookat_pose

from dvrk_cmaes import Body, Camera, Renderer
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.silhouette import OutlinePoints
from dvrk_cmaes.silhouette.moving_points import moving_points

PINHOLE = Camera(640, 480, 880, 880, 330, 250)
CAMERAS = {
    "pinhole": PINHOLE,
    "plumb_bob": Camera(640, 480, 880, 880, 330, 250, (-0.3, 0.1, 0.001, 0.0, 0.0)),
    "equidistant": Camera(640, 480, 880, 880, 330, 250, (0.01, 0.0, 0.0, 0.0), "equidistant"),
}
AT = Posed(
    np.stack([lookat_pose(0.5, 1.0, 0.7, 0.11), lookat_pose(0.3, -1.0, 0.5, 0.12)]),
    np.array([[0.4, -0.3, 0.5], [0.1, 0.2, 0.3]]),
)


def outlines_of(body: Body, camera: Camera) -> list[OutlinePoints]:
    return Renderer(body, camera).outlines(AT.pose, AT.joints)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
def test_jacobian_is_derivative_of_projection(bundled_body: Body, camera: Camera) -> None:
    outlines = outlines_of(bundled_body, camera)
    for k, moving in enumerate(moving_points(bundled_body.instrument, camera, outlines, AT)):
        for column, change in enumerate(1e-6 * np.eye(9)):
            there, back = (
                camera.project(placed_points(bundled_body.instrument, outlines[k], AT[k].moved(s * change)))
                for s in (1, -1)
            )
            expected = ((there - back) / 2e-6 * outlines[k].normals).sum(axis=1)
            np.testing.assert_allclose(moving.jacobian[:, column], expected, atol=1e-6 * np.abs(moving.jacobian).max())


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
def test_points_lie_where_the_outline_was_drawn(bundled_body: Body, camera: Camera) -> None:
    outlines = outlines_of(bundled_body, camera)
    for outline, moving in zip(outlines, moving_points(bundled_body.instrument, camera, outlines, AT), strict=True):
        np.testing.assert_allclose(moving.pixels, outline.pixels, atol=1e-6)


def test_poses_together_are_as_each_by_itself(bundled_body: Body) -> None:
    outlines = outlines_of(bundled_body, PINHOLE)
    together = moving_points(bundled_body.instrument, PINHOLE, outlines, AT)
    for k, moving in enumerate(together):
        (alone,) = moving_points(bundled_body.instrument, PINHOLE, [outlines[k]], AT[[k]])
        np.testing.assert_allclose(moving.jacobian, alone.jacobian, rtol=1e-12, atol=1e-9)


def test_points_behind_the_camera_have_their_depth(bundled_body: Body) -> None:
    outlines = outlines_of(bundled_body, PINHOLE)
    back = AT.seen_from(np.diag([1.0, -1.0, -1.0, 1.0]))
    for moving in moving_points(bundled_body.instrument, PINHOLE, outlines, back):
        assert moving.depth.max() < 0
        assert np.isfinite(moving.jacobian).all()
