"""The layers of a frame's drawing: outlines that enclose mask and silhouettes, and a picture of limited size."""

from __future__ import annotations

import base64
from dataclasses import replace

import cv2
import numpy as np
from helpers.canned_results import canned

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.draw.frame_layers import alternative_names, frame_layers
from dvrk_cmaes.geometry import moved
from dvrk_cmaes.results.layers import Outline
from dvrk_cmaes.results.parts import Alternative
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.silhouette import Body, Renderer

CAMERA = Camera(640, 480, 1030.0, 1030.0, 318.2, 243.7)
POSE = moved(np.eye(4), [0.0, 0.0, 0.11, 0.4, -2.2, 0.3])
JOINTS = {"wrist_pitch": 0.5, "wrist_yaw": -0.4, "jaw": 0.8}
TWIN = Alternative(moved(POSE, [0.002, 0.0, 0.0, 0.0, 0.0, 0.2]), {**JOINTS, "jaw": 1.2}, 0.1, 0.9, "mirror twin")
RESULT: Result = replace(canned("a"), camera_from_root=POSE, joints=JOINTS, alternatives=(TWIN,))


def silhouette(body: Body, pose: np.ndarray, joints: dict[str, float]) -> np.ndarray:
    return Renderer(body, CAMERA, threads=1).masks(pose[None], np.array([list(joints.values())]))[0]


def filled(outline: Outline) -> np.ndarray:
    rings = [np.rint(np.reshape(ring, (-1, 1, 2))).astype(np.int32) for ring in outline.rings]
    return cv2.fillPoly(np.zeros((480, 640), np.uint8), rings, 1) > 0


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / (one | other).sum())


def test_outlines_enclose_mask_and_silhouettes(bundled_body: Body) -> None:
    mask = silhouette(bundled_body, moved(POSE, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0]), JOINTS)
    layers = frame_layers(RESULT, mask, CAMERA, bundled_body)
    assert [one.name for one in layers.outlines] == ["mask", "result", "mirror twin"]
    expected = [
        mask,
        *(
            silhouette(bundled_body, pose, joints)
            for pose, joints in ((POSE, JOINTS), (TWIN.camera_from_root, TWIN.joints))
        ),
    ]
    for one, region in zip(layers.outlines, expected, strict=True):
        assert region.any()
        assert overlap(filled(one), region) > 0.98
    assert overlap(*expected[1:]) < 0.95
    assert layers.picture is None


def test_layers_without_pose_have_the_mask_alone(bundled_body: Body) -> None:
    mask = np.zeros((480, 640), bool)
    mask[100:300, 200:400] = True
    layers = frame_layers(replace(RESULT, camera_from_root=None, status="failed"), mask, CAMERA, bundled_body)
    (outline,) = layers.outlines
    assert (filled(outline) == mask).all()
    assert frame_layers(RESULT, ~mask & False, CAMERA, bundled_body).outlines[0].rings == ()


def test_noise_has_a_limited_number_of_rings(bundled_body: Body) -> None:
    noise = np.random.default_rng(0).random((480, 640)) < 0.3
    assert len(frame_layers(RESULT, noise, CAMERA, bundled_body).outlines[0].rings) <= 200


def test_large_picture_is_reduced(bundled_body: Body) -> None:
    image = np.full((1200, 1600, 3), (200, 10, 10), np.uint8)
    picture = frame_layers(RESULT, np.zeros((480, 640), bool), CAMERA, bundled_body, image=image).picture
    assert picture is not None
    read = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)
    assert read is not None
    assert read.shape == (720, 960, 3)
    assert np.abs(read.astype(int) - (200, 10, 10)).max() < 8


def test_several_alternatives_of_a_kind_are_numbered() -> None:
    other = replace(TWIN, relation="other mode")
    assert alternative_names([other, TWIN, other]) == ("other mode", "mirror twin", "other mode 2")
