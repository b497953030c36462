"""Each constant's effect on the outlines is the derivative of what it does to a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.session_worlds import SMALL, make_frames_in_memory
from helpers.transforms import transform

from dvrk_cmaes import Body, EstimateConfig, FrameData, Renderer, Rig
from dvrk_cmaes.calibration.constants import Constant, OutlineOfView, ViewAsSeen
from dvrk_cmaes.calibration.session_camera import CameraChange
from dvrk_cmaes.calibration.session_masks import MaskMargin
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.sized_view import SizedView

PLACE = transform(np.eye(3), [-0.0053, 0.0, 0.0])
CASES: dict[str, tuple[Constant, list[float]]] = {
    "camera": (CameraChange(), [0.004, 1.0, 1.0]),
    "margin": (MaskMargin(), [0.5]),
}


def both_eyes(body: Body) -> tuple[StoredFrame, Posed]:
    """A frame that both eyes show, and the true pose."""
    _, truths, frames = make_frames_in_memory(body, 3, level="clean", seed=11)
    at = Posed(truths[0].camera_from_root, truths[0].values)
    assert isinstance(frames[0].data, FrameData)
    there = Renderer(body, SMALL).masks((PLACE @ at.pose)[None], at.joints[None])[0]
    data = FrameData.of({"left": frames[0].data.mask, "right": there}, Rig.stereo(SMALL, SMALL, PLACE))
    return StoredFrame.of(data, at, body, EstimateConfig()), at


def moments(image: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Give the area of an image and its first moments, px, about the middle of the camera's image."""
    rows, columns = np.indices(image.shape)
    across, down = columns + corner[0] - SMALL.cx, rows + corner[1] - SMALL.cy
    return np.array([image.sum(), (image * across).sum() / 100, (image * down).sum() / 100])


@pytest.mark.parametrize("case", CASES)
def test_effect_is_the_derivative_of_what_is_seen(case: str, bundled_body: Body) -> None:
    """The displacements of an outline's points move as much area as the silhouette gains and the mask loses."""
    constant, steps = CASES[case]
    stored, at = both_eyes(bundled_body)
    one, poses = stored.views[-1], Posed.stacked([at])

    def sized(values: np.ndarray) -> SizedView:
        """Give the right view as it is seen with some values."""
        seen = constant.seen(one.name, ViewAsSeen(SMALL, one.view_from_camera, 0.0, 1.0), values)
        view = replace(one.restored(bundled_body), view_from_camera=seen.place)
        return SizedView(view, blur=1.2, margin=seen.margin).with_camera(seen.camera)

    here = sized(np.zeros(len(steps)))
    (points,) = here.outlines(poses)
    corner = np.array([SMALL.cx - here.camera.cx, SMALL.cy - here.camera.cy])
    (by_pose,) = here.jacobians([points], poses)
    effect = constant.effect(OutlineOfView(one.name, here, points, by_pose, at, 1.0))
    from_centre = (points.pixels + corner - [SMALL.cx, SMALL.cy]) / 100
    expected = np.column_stack([np.ones(len(effect)), from_centre]).T @ effect
    for index, step in enumerate(steps):
        change = np.zeros(len(steps))
        change[index] = step
        views = sized(change), sized(-change)
        drawn = [view.draw(poses, 2, [0.5], None)[0] for view in views]
        gained = [one.coverage(view.camera.width) - view.target.image for one, view in zip(drawn, views, strict=True)]
        found = (moments(gained[0], corner) - moments(gained[1], corner)) / (2 * step)
        np.testing.assert_allclose(found, expected[:, index], atol=0.1 * np.linalg.norm(expected[:, index]))
