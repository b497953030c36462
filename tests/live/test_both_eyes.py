"""Frames of several arms and eyes: how parts are paired, who is followed when time is short, cameras that change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from helpers.live_wires import BEGIN, SECOND, Found, Steps, Wire, image, info, stamp
from helpers.transforms import moved

from dvrk_cmaes import Camera, Rig
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.live.arm import LiveArm
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics, LiveFrame
from dvrk_cmaes.live.loop import LiveLoop
from dvrk_cmaes.live.outputs import Outputs
from dvrk_cmaes.live.stamps import Ages

ARMS = ("PSM1", "PSM2")
EYES = {
    eye: EyeTopics.of(f"/{eye}/image", masks={arm: f"/{eye}/{arm}/mask" for arm in ARMS}) for eye in ("left", "right")
}
MASKED = InputTopics(EYES, {arm: (f"/{arm}/measured_js",) for arm in ARMS}, "/ECM/measured_js")
PLAIN = InputTopics({"left": EyeTopics.of("/left/image_rect/compressed")}, {"PSM1": ("/PSM1/measured_js",)})
BASE = moved(np.eye(4), [0.1, 0.2, 0.3, 0.1, 0.2, 0.3])


@dataclass
class Clock:
    """A clock that is set."""

    now: float = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Tracker(Steps):
    """Keeps what it was given."""

    rig: Rig
    steps: list[tuple[float, Any, Any, Any]] = field(default_factory=list)

    def step(self, readings: Any, time: float, mask: Any = None, image: Any = None, ignore: Any = None) -> Found:
        self.steps.append((time, mask, image, ignore))
        return Found(camera_from_base=BASE)


@dataclass
class Robot:
    """A loop whose messages are sent one by one, and its trackers by arm, the newest last."""

    topics: InputTopics
    rig: Rig | None = None
    rectified: bool = False
    clock: Clock = field(default_factory=Clock)
    wire: Wire = field(default_factory=Wire)
    lines: list[str] = field(default_factory=list)
    shown: list[str] = field(default_factory=list)
    trackers: dict[str, list[Tracker]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.inputs = Inputs(self.topics, self.lines.append, rectified=self.rectified, now=self.clock)
        self.inputs.subscribe(self.wire)
        arms = [self._arm(arm) for arm in self.topics.joints]
        show = lambda state: self.shown.append(state())  # noqa: E731
        self.loop = LiveLoop(arms, self.inputs, self.lines.append, rig=self.rig, show=show)

    def _arm(self, arm: str) -> LiveArm:
        def make(rig: Rig) -> Tracker:
            self.trackers.setdefault(arm, []).append(Tracker(rig))
            return self.trackers[arm][-1]

        outputs = Outputs(self.wire, FrameNames(arm, "camera", f"{arm}_base"))
        return LiveArm(arm, make, outputs, self.lines.append, self.clock)

    def send(self, topic: str, fields: Mapping[str, Any]) -> None:
        self.wire.receivers[topic](fields)

    def published(self, topic: str) -> list[Mapping[str, Any]]:
        return [fields for name, fields in self.wire.published if name == topic]


def pair(focal: float = 60.0) -> Rig:
    return Rig.stereo(camera(focal), camera(focal), moved(np.eye(4), [-0.005, 0, 0, 0, 0, 0]))


def camera(focal: float = 60.0, *, distorted: bool = False) -> Camera:
    return Camera(64, 48, focal, focal, 31.5, 23.5, (-0.1, 0.0, 0.0, 0.0, 0.0) if distorted else ())


def masks_at(robot: Robot, time: float, *, right: float = 0.0, without: str = "") -> None:
    """Send the masks of both arms and eyes at a time, s, those of the right eye later by some."""
    for eye, late in (("left", 0.0), ("right", right)):
        for k, arm in enumerate(ARMS):
            if without != f"/{eye}/{arm}/mask":
                robot.send(f"/{eye}/{arm}/mask", image(time + late, np.eye(48, 64, 5 * k, dtype=np.uint8) * 255))


def test_images_that_are_too_far_apart_are_no_frame_and_what_waits_is_bounded() -> None:
    robot = Robot(MASKED, pair())
    for k in range(40):
        masks_at(robot, k / 30, right=0.012)
        assert robot.inputs.frames.take(0.0) is None
    assert {eye: len(parts) for eye, parts in robot.inputs._parts.items()} == {"left": 8, "right": 8}
    masks_at(robot, 2.0)
    frame = robot.inputs.frames.take(0.0)
    assert frame is not None
    assert {eye: len(parts) for eye, parts in robot.inputs._parts.items()} == {"left": 0, "right": 0}


def test_eye_that_is_silent_is_not_waited_for() -> None:
    robot = Robot(MASKED, pair())

    def frame_at(time: float, without: str) -> LiveFrame | None:
        robot.clock.now = 100.0 + time
        for topic in (f"/left/{arm}/mask" for arm in ARMS) if without == "right" else ():
            robot.send(topic, image(time, np.zeros((48, 64), np.uint8)))
        if not without:
            masks_at(robot, time)
        return robot.inputs.frames.take(0.0)

    assert frame_at(0.0, "right") is None
    assert frame_at(0.5, "") is not None
    assert frame_at(1.0, "right") is None
    alone = frame_at(1.6, "right")
    assert alone is not None
    assert {arm: list(eyes) for arm, eyes in alone.decoded().masks.items()} == {"PSM1": ["left"], "PSM2": ["left"]}
    both = frame_at(1.7, "")
    assert both is not None
    masks_at(robot, 1.8)
    again = robot.inputs.frames.take(0.0)
    assert again is not None
    assert list(again.decoded().masks["PSM1"]) == ["left", "right"]


def test_topics_are_silent_only_from_the_connection_on() -> None:
    class Later(Wire):
        up = False

        @property
        def connected(self) -> bool:
            return self.up

    wire = Later()
    robot = Robot(PLAIN, wire=wire)
    for now, connected, silent in ((100.0, False, 0), (103.0, False, 0), (103.5, True, 0), (104.8, True, 2)):
        robot.clock.now, wire.up = now, connected
        assert len(robot.inputs.report_silence()) == silent
        assert len(robot.lines) == silent
    assert robot.lines[0].endswith(": no message for 1.8 s")
    robot.send("/PSM1/measured_js", {"header": stamp(0.0), "name": ["jaw"], "position": [0.5]})
    robot.inputs.report_silence()
    assert robot.lines[-1] == "/PSM1/measured_js: first message"
    wire.up, robot.clock.now = False, 106.0
    assert (robot.inputs.report_silence(), len(robot.lines)) == ((), 3)


def test_images_without_the_masks_that_are_awaited_are_no_frames_and_no_error() -> None:
    robot = Robot(MASKED, pair())
    for k in range(40):
        robot.clock.now = 100.0 + k / 10
        robot.send("/left/image", image(k / 10, np.zeros((48, 64), np.uint8)))
        robot.loop.turn()
    assert robot.loop.counts.followed == robot.loop.counts.refused == 0
    assert not any("cannot be read" in line for line in robot.lines)
    assert any(line.startswith("/left/PSM1/mask: no message for") for line in robot.lines)


def test_transforms_of_each_arms_tool_and_base_are_fit_for_tf2() -> None:
    robot = Robot(MASKED, pair())
    masks_at(robot, 0.0)
    robot.loop.turn()
    for message, arm in zip(robot.published("/tf"), ARMS, strict=True):
        frames = [(one["header"]["frame_id"], one["child_frame_id"]) for one in message["transforms"]]
        assert frames == [("camera", f"{arm}_roll_link"), ("camera", f"{arm}_base")]
        assert all(one["header"]["stamp"] == stamp(0.0)["stamp"] for one in message["transforms"])
        moved_by = message["transforms"][1]["transform"]["translation"]
        assert [moved_by[axis] for axis in "xyz"] == pytest.approx(BASE[:3, 3])


def test_readings_of_the_endoscopes_arm_are_kept_for_each_arm_and_bounded() -> None:
    robot = Robot(MASKED, pair())
    names = ["yaw", "pitch", "insertion", "roll"]
    for k in range(1500):
        position = [0.1, 0.2, 0.05, 1e-3 * k]
        robot.send("/ECM/measured_js", {"header": stamp(k / 100), "name": names, "position": position})
    for own in robot.inputs.readings.values():
        kept = own.take_all()
        assert (len(kept), kept[-1].joints["ecm_roll"]) == (1000, 1e-3 * 1499)


def test_whole_readings_of_the_endoscopes_arm_are_given_to_all_arms() -> None:
    robot = Robot(MASKED, pair())
    names = ["outer_yaw", "outer_pitch", "outer_insertion", "outer_roll"]
    robot.send("/ECM/measured_js", {"header": stamp(1.0), "name": names, "position": [0.1, 0.2, 0.1, 0.3]})
    expected = {"ecm_yaw": 0.1, "ecm_pitch": 0.2, "ecm_insertion": 0.1, "ecm_roll": 0.3}
    assert [[one.joints for one in own.take_all()] for own in robot.inputs.readings.values()] == [
        [expected],
        [expected],
    ]


@pytest.mark.parametrize(
    ("topic", "rectified", "remark"),
    [
        ("/left/image_rect_color/compressed", False, "its images are rectified, by its name: --rectified uses"),
        ("/left/image_rect", True, ""),
        ("/left/image_raw", False, ""),
        ("/left/image_raw", True, "its images are not rectified, by its name, but --rectified says so"),
        ("/left/image", False, ""),
    ],
)
def test_name_of_a_topic_that_contradicts_the_options_has_a_remark(topic: str, rectified: bool, remark: str) -> None:
    topics = replace(PLAIN, eyes={"left": EyeTopics.of(topic)})
    robot = Robot(topics, Rig.of_camera(camera(distorted=not rectified)), rectified=rectified)
    said = [line for line in robot.lines if line.startswith("warning: ")]
    assert len(said) == bool(remark)
    assert all(line.startswith(f"warning: {topic}: {remark}") for line in said)


def test_age_is_that_since_the_least_way_of_an_image() -> None:
    ages = Ages()
    for k, way in enumerate((0.9, 0.5, 0.7)):
        ages.receive(BEGIN + k * SECOND, 50.0 + k + way)
    assert ages.age(BEGIN + 2 * SECOND, 52.7) == pytest.approx(0.2, abs=1e-3)
    assert ages.age(BEGIN + 2 * SECOND, 53.0) == pytest.approx(0.5, abs=1e-3)
    ages.receive(BEGIN + 3 * SECOND, 75.0)  # after a pause of a recording
    assert ages.age(BEGIN + 3 * SECOND, 75.1) == pytest.approx(0.1)
    drift = Ages()
    for k in range(7200):
        drift.receive(BEGIN + k * SECOND, k * (1 + 5e-5))
    assert drift.age(BEGIN + k * SECOND, k * (1 + 5e-5)) < 0.01


def test_poses_of_old_images_are_doubtful_with_a_line() -> None:
    robot = Robot(PLAIN, Rig.of_camera(camera()))
    ways = [0.0, 0.4, *[1.5] * 10]
    for k, way in enumerate(ways):
        robot.clock.now = 100.0 + k / 10 + way
        robot.send("/left/image_rect/compressed", image(k / 10, np.zeros((48, 64), np.uint8)))
        robot.loop.turn()
    statuses = [fields["status"][0] for fields in robot.published("/diagnostics")]
    followed = [one for one in statuses if one["message"] in ("ok", "doubtful")]
    assert [one["message"] for one in followed[:2]] == ["ok", "ok"]
    assert followed[-1]["message"] == "doubtful"
    values = {one["key"]: one["value"] for one in followed[-1]["values"]}
    assert values["reasons"] == "the image is 1.5 s old"
    assert float(values["age_ms"]) == pytest.approx(1500, abs=5)
    assert "images are 1.5 s old: this computer, or the way here, is too slow" in robot.lines
    assert len(followed) == len(ways)


@pytest.mark.parametrize("change", ["focal length", "size"])
def test_camera_that_changes_begins_anew_with_a_line(change: str) -> None:
    robot = Robot(PLAIN)
    other = camera(80.0) if change == "focal length" else camera().scaled(128, 96)
    for k, one in enumerate((camera(), camera(), other, other)):
        robot.send("/left/camera_info", info(one))
        robot.send("/left/image_rect/compressed", image(k / 10, np.zeros((one.height, one.width), np.uint8)))
        robot.loop.turn()
    cameras = [tracker.rig.camera for tracker in robot.trackers["PSM1"]]
    assert [(one.width, one.fx) for one in cameras] == [(64, 60.0), (other.width, other.fx)]
    assert [len(tracker.steps) for tracker in robot.trackers["PSM1"]] == [2, 2]
    (line,) = robot.lines[1:]
    assert line == (
        f"camera: {other.width} x {other.height} px, focal length {other.fx:.1f} px; it has changed, and following "
        "begins anew"
    )
