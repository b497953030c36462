"""The derivative of each block is that of what it changes: of what is predicted of frames, and of what views show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from helpers.resized import with_jaws, with_shaft, with_size, with_wrist
from helpers.session_worlds import BASE, EXPECTED_OFFSETS, NAMES, SMALL, make_frames_in_memory, make_world
from helpers.transforms import moved, transform

from dvrk_cmaes import Body, EstimateConfig, FrameData, Renderer, Rig, SessionCalibration, calibrate_session
from dvrk_cmaes.calibration import session_problem
from dvrk_cmaes.calibration.blocks import Block, Calibration, FoundBlock, OutlineOfView, SeenBlock, ViewAsSeen
from dvrk_cmaes.calibration.endoscope import Endoscope, Pieces, Steered
from dvrk_cmaes.calibration.session_camera import CameraChange
from dvrk_cmaes.calibration.session_masks import MaskBias, MaskMargin
from dvrk_cmaes.calibration.session_problem import TESTED
from dvrk_cmaes.calibration.session_shaft import InstrumentSizes
from dvrk_cmaes.calibration.stored_frame import StoredFrame
from dvrk_cmaes.geometry import Posed
from dvrk_cmaes.pose.terms.sized_view import SizedView

PLACE = transform(np.eye(3), [-0.0053, 0.0, 0.0])


def steered() -> Endoscope:
    read = np.repeat([[0.1, 0.05, 0.12, 0.2], [0.2, -0.05, 0.13, 0.1], [0.0, 0.1, 0.1, 0.4]], 4, axis=0)
    read[5] += 0.02  # in motion
    found = Steered.of(read)
    assert found is not None
    moving = found.start.changed(0.05 * np.random.default_rng(0).standard_normal(len(found.start.std)))
    return found.with_start(moving, found.loose)


def pieces() -> Endoscope:
    cameras = moved(np.eye(4), np.random.default_rng(0).normal(0, 0.1, (2, 6)))
    return Pieces.of(np.repeat([0, 2, 1], 4), cameras)


@pytest.mark.parametrize("endoscope", [lambda: None, steered, pieces])
def test_predictions_change_as_the_derivatives_of_the_blocks_say(endoscope: Callable[[], Endoscope | None]) -> None:
    """Of base, offsets, and an endoscope that is read or is not."""
    model = replace(make_world(12, seed=1).model, endoscope=endoscope())
    calibration = model.calibration(BASE, np.full(5, 0.01))
    at = model.predict(calibration)
    for block in calibration.predicted:
        place, derivative = calibration.place(block.name), block.derivative(model, calibration)
        assert derivative.shape == (12, 6 + len(NAMES), len(block.std))
        for k, column in enumerate(np.moveaxis(derivative, 2, 0)):
            step = 1e-6 * np.eye(len(calibration.axes))[place.start + k]
            later, earlier = (model.predict(calibration.changed(sign * step)).minus(at) for sign in (1, -1))
            np.testing.assert_allclose(column, (later - earlier) / 2e-6, atol=1e-7, err_msg=block.axes[k])


@dataclass(frozen=True)
class Shown:
    """What a view shows with a change of one unknown, ``number``, of a block by ``step``, and with the opposite one."""

    block: Callable[[Body], SeenBlock]
    number: int
    step: float
    instrument: Callable[[Body, float], Body] | None = None
    mask: Callable[[np.ndarray], np.ndarray] | None = None


def shadowed(mask: np.ndarray) -> np.ndarray:
    """Give a mask with a shadow on its right side, a pixel wide."""
    shifted = cv2.warpAffine(mask.astype(np.uint8), np.array([[1.0, 0, 1], [0, 1, 0]]), mask.shape[::-1])
    return mask | (shifted > 0)


def made_by_the_list(number: int) -> Callable[[Body], SeenBlock]:
    return lambda body: TESTED[number](EstimateConfig(), SMALL)


CASES = {
    "focal length": Shown(lambda body: CameraChange(), 0, 0.004),
    "principal point to the right": Shown(lambda body: CameraChange(), 1, 1.0),
    "principal point down": Shown(lambda body: CameraChange(), 2, 1.0),
    "margin": Shown(lambda body: MaskMargin(), 0, 0.5),
    "what faces right": Shown(lambda body: MaskBias(), 2, 0.5, mask=shadowed),
    "shaft": Shown(lambda body: InstrumentSizes(body.instrument), 0, np.log(1.03), instrument=with_shaft),
    "wrist": Shown(lambda body: InstrumentSizes(body.instrument), 1, np.log(1.03), instrument=with_wrist),
    "jaws": Shown(lambda body: InstrumentSizes(body.instrument), 2, np.log(1.03), instrument=with_jaws),
    "whole": Shown(lambda body: InstrumentSizes(body.instrument), 3, np.log(1.03), instrument=with_size),
} | {
    f"{block.name} {axis}": Shown(made_by_the_list(number), k, float(block.std[k]))
    for number, block in enumerate(make(EstimateConfig(), SMALL) for make in TESTED)
    for k, axis in enumerate(block.axes)
}


def moments(image: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Give the area of an image and its first moments, px, about the middle of the camera's image."""
    rows, columns = np.indices(image.shape)
    across, down = columns + corner[0] - SMALL.cx, rows + corner[1] - SMALL.cy
    return np.array([image.sum(), (image * across).sum() / 100, (image * down).sum() / 100])


@pytest.mark.parametrize("case", CASES)
def test_outlines_change_as_the_effect_of_a_block_says(case: str, bundled_body: Body) -> None:
    """The displacements of an outline's points move as much area as the silhouette gains and the mask loses."""
    shown, (_, truths, frames) = CASES[case], make_frames_in_memory(bundled_body, 3, level="clean", seed=11)
    block, at = shown.block(bundled_body), Posed(truths[0].camera_from_root, truths[0].values)
    assert isinstance(frames[0].data, FrameData)
    there = Renderer(bundled_body, SMALL).masks((PLACE @ at.pose)[None], at.joints[None])[0]

    def view(sign: int) -> SizedView:
        """Give the right view as it is seen with the change."""
        mask = shown.mask(there) if shown.mask is not None and sign > 0 else there
        data = FrameData.of({"left": frames[0].data.mask, "right": mask}, Rig.stereo(SMALL, SMALL, PLACE))
        one = StoredFrame.of(data, at, bundled_body, EstimateConfig()).views[-1]
        body = bundled_body
        if shown.instrument is not None and sign:
            body = shown.instrument(bundled_body, float(np.exp(sign * shown.step)))
        values = sign * shown.step * np.eye(len(block.std))[shown.number]
        seen = block.seen(one.name, ViewAsSeen(SMALL, one.view_from_camera, 0.0, 1.0), values)
        whole = replace(one.restored(body), view_from_camera=seen.place)
        return SizedView(whole, blur=1.2, margin=seen.margin).with_camera(seen.camera)

    here, poses = view(0), Posed.stacked([at])
    (points,) = here.outlines(poses)
    corner = np.array([SMALL.cx - here.camera.cx, SMALL.cy - here.camera.cy])
    (by_pose,) = here.jacobians([points], poses)
    effect = block.effect(OutlineOfView("right", here, points, by_pose, at, 1.0))[:, shown.number]
    from_centre = (points.pixels + corner - [SMALL.cx, SMALL.cy]) / 100
    expected = np.column_stack([np.ones(len(effect)), from_centre]).T @ effect

    def gained(seen: SizedView) -> np.ndarray:
        drawn = seen.draw(poses, 2, [0.5], None)[0].coverage(seen.camera.width)
        image = seen.target.image - drawn if shown.mask is not None else drawn - seen.target.image
        origin = np.array([SMALL.cx - here.camera.cx, SMALL.cy - here.camera.cy])
        return moments(image, origin)

    found = (gained(view(1)) - gained(view(-1))) / (2 * shown.step)
    np.testing.assert_allclose(found, expected, atol=0.15 * np.linalg.norm(expected))


def test_a_calibration_has_the_values_of_its_blocks_in_the_order_of_a_step() -> None:
    camera, margin = CameraChange(), MaskMargin()
    calibration = Calibration.of(np.eye(4), np.zeros(5), EXPECTED_OFFSETS).with_blocks(camera, margin)
    assert (calibration.place("camera"), calibration.place("margin")) == (slice(11, 14), slice(14, 15))
    assert len(calibration.axes) == len(calibration.deviation) == 15
    assert calibration.own == 11
    step = np.arange(15.0)
    step[:6] = 0
    changed = calibration.changed(step)
    np.testing.assert_array_equal(changed.values["camera"], [11, 12, 13])
    np.testing.assert_array_equal(changed.further, [11, 12, 13, 14])
    np.testing.assert_allclose(np.diag(calibration.information)[6:], [*EXPECTED_OFFSETS**-2, *camera.std**-2, 1.0])
    assert not np.diag(calibration.information)[:6].any()
    assert len(changed.alone().further) == 0


def test_a_block_takes_the_place_of_one_of_the_same_name() -> None:
    calibration = Calibration.of(np.eye(4), np.zeros(5)).with_blocks(Block("one", np.ones(1)), one=np.array([3.0]))
    known = calibration.with_blocks(Block("one", np.array([0.1])), one=np.zeros(1))
    assert known.information[-1, -1] == pytest.approx(100)
    assert len(known.axes) == 12
    assert len(known.without("one").axes) == 11


class Aspect(SeenBlock):
    """The logarithm (1,) of the factor on the vertical focal length."""

    def __init__(self) -> None:
        super().__init__("aspect", np.array([0.05]))

    def seen(self, name: str, by: ViewAsSeen, values: np.ndarray) -> ViewAsSeen:
        """Give the view with the changed camera."""
        return replace(by, camera=replace(by.camera, fy=by.camera.fy * float(np.exp(values[0]))))

    def effect(self, outline: OutlineOfView) -> np.ndarray:
        """Give the displacements, which are in proportion to the distance from the centre."""
        down = outline.points.pixels[:, 1] - outline.view.camera.cy
        return (outline.points.normals[:, 1] * down)[:, None]

    def stated(self, values: np.ndarray, std: np.ndarray) -> FoundBlock:
        """State the factor, and doubt the file where it is clear."""
        doubt = "the pixels are not square" if abs(values[0]) > std[0] else ""
        found = tuple(values.tolist()), tuple(std.tolist()), tuple(self.std.tolist())
        return FoundBlock(self.axes, *found, f"aspect {values[0]:+.3f}", doubt)


def test_a_block_of_the_list_is_found_stated_and_widens_the_calibration(
    bundled_body: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = make_frames_in_memory(bundled_body, 10, level="clean")[2]
    plain = calibrate_session(frames, bundled_body).calibration
    monkeypatch.setattr(session_problem, "TESTED", (lambda config, camera: Aspect(),))
    right = calibrate_session(frames, bundled_body).calibration
    flat = replace(SMALL, fy=SMALL.fy / 1.06)
    stretched = [replace(one, data=one.data.with_camera(flat)) for one in frames if isinstance(one.data, FrameData)]
    wrong = calibrate_session(stretched, bundled_body).calibration
    found = right.to_dict()["blocks"]["aspect"]
    assert abs(found["values"][0]) < 3 * found["std"][0] < 0.06
    assert found["text"] in [*right.in_words()]
    assert not right.doubts
    (value,), (std,) = wrong.blocks["aspect"].values, wrong.blocks["aspect"].std
    assert abs(value - np.log(1.06)) < 2.5 * std < 0.06
    assert value > found["values"][0] + 0.01
    assert "the pixels are not square" in wrong.doubts
    assert np.trace(wrong.covariance[:6, :6]) > np.trace(plain.covariance[:6, :6])
    assert SessionCalibration.from_dict(wrong.to_dict()).blocks["aspect"].doubt == "the pixels are not square"
