"""Arms that are followed in processes of their own: the same poses as in this one; what a process that dies costs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import psutil
import pytest
from helpers.live_wires import Stage
from helpers.moving_worlds import SMALL, moving_world

from dvrk_cmaes import Rig, TrackResult
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.ros_messages import header
from dvrk_cmaes.live.arm_process import ArmProcess, Start
from dvrk_cmaes.live.connection import Report
from dvrk_cmaes.live.follow import ArmSetup, LiveSetup
from dvrk_cmaes.live.inputs import EyeTopics, Inputs, InputTopics
from dvrk_cmaes.runs.pool import serving_process

SEEDS = {"PSM1": 3, "PSM2": 4}
MASKS = {arm: f"/left/{arm}/mask" for arm in SEEDS}
TOPICS = InputTopics(
    {"left": EyeTopics("", "/left/camera_info", MASKS)}, {arm: (f"/{arm}/measured_js",) for arm in SEEDS}
)
BEGIN = 10**9  # ns


def played(start: Start | None, images: int, dies_at: int | None = None) -> tuple[Stage, list[str]]:
    """Play images of two arms through the loop, before one of which all processes are killed; also returns lines."""
    stage, lines, others = Stage(stamp=BEGIN), list[str](), workers()
    arms = {arm: moving_world(seed=seed) for arm, seed in SEEDS.items()}
    setup = LiveSetup(
        TOPICS,
        tuple(
            ArmSetup(
                FrameNames(arm, "camera", f"{arm}_base"),
                world.body,
            )
            for arm, world in arms.items()
        ),
        rig=Rig.of(SMALL),
        origin=BEGIN,
        start_process=start,
    )
    with ExitStack() as stack:
        inputs = Inputs(TOPICS, lines.append, now=lambda: stage.now)
        loop = setup.loop(inputs, stage, lines.append, stack)
        for k in range(images):
            if k == dies_at:
                for child in workers(others):
                    child.kill()
            stamp = BEGIN + round(1e9 * k / 30)
            for arm, world in arms.items():
                readings = {"name": list(world.readings[k]), "position": list(world.readings[k].values())}
                stage.send(stamp, {f"/{arm}/measured_js": {"header": header(stamp), **readings}})
            size = {"width": SMALL.width, "height": SMALL.height, "step": SMALL.width, "encoding": "mono8"}
            data = {arm: np.asarray(255 * world.masks[k], np.uint8).tobytes() for arm, world in arms.items()}
            stage.send(stamp, {MASKS[arm]: {"header": header(stamp), **size, "data": data[arm]} for arm in SEEDS})
            loop.turn()
            time.sleep(0.08)  # for the searches of the first image, in the background
        started = workers(others)
    _, alive = psutil.wait_procs(started, 30)  # those that solve keyframes are not killed, but end with their arm's
    assert not alive
    return stage, lines


def workers(others: Sequence[psutil.Process] = ()) -> list[psutil.Process]:
    """Return the processes that this one and its processes have started; not others, nor one that tracks resources."""
    children = [child for child in psutil.Process().children(recursive=True) if child not in others]
    return [child for child in children if "resource_tracker" not in " ".join(child.cmdline())]


def test_arms_in_processes_of_their_own_have_the_same_poses() -> None:
    (here, lines), (apart, same_lines) = (played(start, 26) for start in (None, serving_process))
    assert lines == same_lines
    for arm, poses in here.poses.items():
        both = poses.keys() & apart.poses[arm].keys()
        assert len(both) >= 3
        assert all(np.array_equal(poses[stamp], apart.poses[arm][stamp]) for stamp in both)
        assert all(here.statuses[arm][stamp] == apart.statuses[arm][stamp] for stamp in both)


@dataclass
class Faulty:
    """An arm whose every step fails."""

    report: Report
    state: str = "faulty"

    def __enter__(self) -> Faulty:
        return self

    def __exit__(self, *error: object) -> None: ...

    def step(self, *arguments: object) -> TrackResult:
        self.report("a line")
        raise ValueError("a fault of the tracker")


def test_step_that_fails_does_not_end_the_process() -> None:
    lines, others = list[str](), workers()
    tracker = ArmProcess(serving_process, cast(Any, Faulty), lines.append)
    (process,) = workers(others)
    for _ in range(2):
        with pytest.raises(ValueError, match="a fault of the tracker"):
            tracker.start_step([], 0.0)()
    assert (lines, tracker.state) == (["a line"] * 2, "faulty")
    tracker.close()
    assert not process.is_running()


def test_process_that_dies_costs_three_images_and_its_arm_begins_anew() -> None:
    stage, lines = played(serving_process, 40, dies_at=18)
    assert sum("the process of this arm died" in line for line in lines) == len(SEEDS)
    assert sum("the process of this arm has ended" in line for line in lines) == 2 * len(SEEDS)
    for arm, poses in stage.poses.items():
        assert min(poses) < BEGIN + 18e9 / 30, arm
        assert max(poses) == stage.stamp, arm
