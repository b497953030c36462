"""Wrong calls of the public functions: each is refused in one line that begins with the argument's name."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import dvrk_cmaes
from dvrk_cmaes import (
    Camera,
    InputError,
    Renderer,
    Result,
    SessionCalibration,
    Tracker,
    estimate,
    estimate_tools,
    load_instrument,
    prepare,
)

CAMERA = Camera(320, 240, 521.3, 521.3, 163.0, 117.5)
MASK = np.zeros((240, 320), np.bool_)
MASK[100:140, 100:200] = True
RADIANS = {"wrist_pitch": -0.2, "wrist_yaw": 0.5, "jaw": 0.8}
DEGREES = {"wrist_pitch": -12.0, "wrist_yaw": 29.0, "jaw": 46.0}
POSE = np.eye(4)
ANY: Any = None


def tracker(*arguments: Any, **named: Any) -> Tracker:
    return Tracker(*(arguments or (CAMERA, "lnd")), **named)


def renderer() -> Renderer:
    return Renderer(prepare("lnd"), CAMERA)


def wrong(name: str) -> Any:
    """Give an argument of a wrong type, which type checkers would refuse."""
    return {"path": "file.png", "matrix": np.eye(3), "list": [0.1, 0.2, 0.3], "dict": {}, "number": 3}[name]


CALLS: dict[str, Callable[[], object]] = {
    "mask: a path": lambda: estimate(wrong("path"), CAMERA, RADIANS),
    "mask: a picture of three channels": lambda: estimate(np.dstack([MASK] * 3), CAMERA, RADIANS),
    "mask: a grey picture": lambda: estimate(np.arange(MASK.size, dtype=np.uint8).reshape(MASK.shape), CAMERA, RADIANS),
    "mask: one row": lambda: estimate(MASK.ravel(), CAMERA, RADIANS),
    "mask: a list": lambda: estimate(wrong("list"), CAMERA, RADIANS),
    "mask: another size": lambda: estimate(MASK[:100], CAMERA, RADIANS),
    "camera: its matrix": lambda: estimate(MASK, wrong("matrix"), RADIANS),
    "camera: a path": lambda: estimate(MASK, wrong("path"), RADIANS),
    "joints: degrees": lambda: estimate(MASK, CAMERA, DEGREES),
    "joints: millimetres": lambda: estimate(MASK, CAMERA, RADIANS | {"insertion": 120.0}),
    "joints: text": lambda: estimate(MASK, CAMERA, RADIANS | {"jaw": wrong("path")}),
    "joints: a list": lambda: estimate(MASK, CAMERA, wrong("list")),
    "joints: an unknown one": lambda: estimate(MASK, CAMERA, {"wrist": 0.1}),
    "instrument: a number": lambda: estimate(MASK, CAMERA, RADIANS, wrong("number")),
    "ignore: a path": lambda: estimate(MASK, CAMERA, RADIANS, ignore=wrong("path")),
    "ignore: another size": lambda: estimate(MASK, CAMERA, RADIANS, ignore=MASK[:10]),
    "keypoints: three numbers": lambda: estimate(MASK, CAMERA, RADIANS, keypoints=wrong("list")),
    "keypoints: text": lambda: estimate(MASK, CAMERA, RADIANS, keypoints=wrong("path")),
    "arm: the arm's name": lambda: estimate(MASK, CAMERA, RADIANS, arm=wrong("path")),
    "session: a path": lambda: estimate(MASK, CAMERA, RADIANS, session=wrong("path")),
    "start: a pose": lambda: estimate(MASK, CAMERA, RADIANS, start=wrong("matrix")),
    "config: a mapping": lambda: estimate(MASK, CAMERA, RADIANS, config=wrong("dict")),
    "tools: masks alone": lambda: estimate_tools({"PSM1": wrong("matrix")}, CAMERA),
    "tools: a list": lambda: estimate_tools(wrong("list"), CAMERA),
    "width: text": lambda: Camera(wrong("path"), 240, 500, 500, 160, 120),
    "fx: nothing": lambda: Camera(320, 240, ANY, 500, 160, 120),
    "distortion: a number": lambda: Camera(320, 240, 500, 500, 160, 120, distortion=wrong("number")),
    "instrument: of a tracker": lambda: tracker(CAMERA, wrong("number")),
    "camera: of a tracker": lambda: tracker(wrong("matrix"), "lnd"),
    "calibration: a path": lambda: tracker(calibration=wrong("path")),
    "arm: of a tracker": lambda: tracker(arm=wrong("path")),
    "lag: text": lambda: tracker(lag=wrong("path")),
    "mask: a path to a step": lambda: tracker().step(0.0, wrong("path")),
    "mask: a picture to a step": lambda: tracker().step(0.0, np.dstack([MASK] * 3)),
    "mask: a grey picture to a step": lambda: tracker().step(0.0, np.arange(MASK.size).reshape(MASK.shape)),
    "ignore: a picture to a step": lambda: tracker().step(0.0, MASK, None, np.dstack([MASK] * 3)),
    "image: a video": lambda: tracker().step(0.0, None, np.zeros((240, 320, 3, 2), np.uint8)),
    "image: numbers of another type": lambda: tracker().step(0.0, None, np.zeros((240, 320, 3))),
    "time: text": lambda: tracker().step(wrong("path"), MASK),
    "readings: degrees": lambda: tracker().add_readings(0.0, DEGREES),
    "readings: a list": lambda: tracker().add_readings(0.0, wrong("list")),
    "start: of a tracker": lambda: tracker().start(0.0, wrong("matrix")),
    "body: an instrument": lambda: Renderer(wrong("number"), CAMERA),
    "camera: of a renderer": lambda: Renderer(prepare("lnd"), wrong("matrix")),
    "camera_from_root: a vector": lambda: renderer().masks(POSE[0], np.zeros((1, 3))),
    "joints: of two poses": lambda: renderer().masks(POSE, np.zeros((2, 3))),
    "camera_from_root: not finite": lambda: renderer().masks(POSE[None] * np.nan, np.zeros((1, 3))),
    "joints: too few": lambda: renderer().masks(POSE[None], np.zeros((1, 2))),
    "joints: of more poses": lambda: renderer().coverage(POSE[None], np.zeros((2, 3))),
    "joints: by name": lambda: renderer().masks(POSE[None], wrong("dict")),
    "instrument: nothing": lambda: prepare(ANY),
    "instrument: a matrix": lambda: load_instrument(wrong("matrix")),
    "path: a number": lambda: dvrk_cmaes.read_result(wrong("number")),
    "path: nothing": lambda: dvrk_cmaes.read_camera(ANY),
    "folder: nothing": lambda: dvrk_cmaes.read_session(ANY),
    "path: of a calibration": lambda: dvrk_cmaes.read_calibration(ANY),
    "folder: of results": lambda: dvrk_cmaes.read_results(wrong("number")),
    "files: a path": lambda: dvrk_cmaes.read_frame(wrong("path"), CAMERA),
    "frames: results": lambda: dvrk_cmaes.calibrate_session(wrong("list"), "lnd"),
    "mask: nothing": lambda: estimate(ANY, CAMERA, RADIANS),
    "result: a path": lambda: Result.from_dict(wrong("path")),
}


@pytest.mark.parametrize("name", CALLS)
def test_wrong_call_is_refused_by_name_of_the_argument(name: str) -> None:
    with pytest.raises(InputError) as caught:
        CALLS[name]()
    said, argument = str(caught.value), name.partition(":")[0]
    assert re.match(rf"{argument}: .*(expected|unknown)", said), said
    assert "\n" not in said
    assert len(said) < 200


def test_degrees_are_named_as_such() -> None:
    with pytest.raises(InputError, match=r"^joints: wrist_pitch: expected radians .* this looks like degrees$"):
        estimate(MASK, CAMERA, DEGREES)


def test_tracker_takes_an_instrument_a_body_or_a_name() -> None:
    instrument = load_instrument("lnd")
    for given in (instrument, prepare(instrument), "lnd"):
        assert Tracker(CAMERA, given).offsets == {}


def test_prepared_body_is_returned_as_it_is() -> None:
    body = prepare("lnd")
    assert prepare(body) is body


def test_result_is_printed_on_one_line_without_its_settings() -> None:
    result = Result(
        frame="0001",
        status="doubtful",
        reasons=("mode is in doubt",),
        instrument="lnd",
        root_link="roll_link",
        camera_from_root=np.eye(4),
        joints={"jaw": 0.5},
        readings={},
        config={"seed": 0},
    )
    expected = "Result('0001', doubtful, position_mm=[0.0, 0.0, 0.0], joints_deg={'jaw': 28.65}, reasons="
    assert repr(result) == f"{expected}['mode is in doubt'])"


def test_instrument_renderer_tracker_and_calibration_are_printed_in_one_line() -> None:
    body = prepare("lnd")
    assert repr(body) == f"Body({body.instrument!r})"
    assert repr(body.instrument).startswith("Instrument('lnd', links: ")
    assert len(repr(body)) < 200
    assert repr(Renderer(body, CAMERA)) == f"Renderer({body!r}, {CAMERA!r})"
    assert repr(Tracker(CAMERA, body)) == "Tracker('lnd', time=None, base not known)"
    found = SessionCalibration("lnd", np.eye(4), {"jaw": 0.1}, (), np.eye(7), np.eye(7), {})
    shown = "ok, 'lnd', 0 frames, base_mm=[0.0, 0.0, 0.0], offsets={'jaw': 0.1}, predicted_iou=1.000"
    assert repr(found) == f"SessionCalibration({shown})"
