"""A connection of `live` within a test's process, and messages as a robot sends them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from dvrk_cmaes import Camera
from dvrk_cmaes.live.connection import Connection

SECOND = 10**9
BEGIN = 1_795_000_000 * SECOND


@dataclass(eq=False)
class Wire(Connection):
    """A connection within this process, which keeps what is published."""

    name: str = "wire"
    published: list[tuple[str, Mapping[str, Any]]] = field(default_factory=list)

    def publish(self, topic: str, fields: Mapping[str, Any]) -> bool:
        self.published.append((topic, fields))
        return True

    @property
    def states(self) -> list[dict[str, Any]]:
        return [fields["status"][0] for topic, fields in self.published if topic == "/diagnostics"]


class Steps:
    """A tracker whose steps are begun and waited for."""

    state = ""

    def start_step(self, *arguments: Any) -> Any:
        return partial(self.step, *arguments)

    def step(self, *arguments: Any) -> Any:
        raise NotImplementedError


@dataclass(frozen=True)
class Found:
    """A result of a step."""

    camera_from_root: np.ndarray | None = field(default_factory=lambda: np.eye(4))
    joints: dict[str, float] = field(default_factory=dict)
    status: str = "ok"
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    tips: np.ndarray | None = None
    camera_from_base: np.ndarray | None = None

    def covariance_in_camera(self) -> None: ...


def stamp(time: float) -> dict[str, Any]:
    seconds, rest = divmod(BEGIN + round(time * SECOND), SECOND)
    return {"stamp": {"sec": seconds, "nanosec": rest}}


def image(time: float, pixels: np.ndarray) -> dict[str, Any]:
    """Give an Image of mono8 at a time, s."""
    height, width = pixels.shape
    size = {"width": width, "height": height, "step": width, "encoding": "mono8"}
    return {"header": stamp(time), **size, "data": pixels.tobytes()}


def info(camera: Camera, *, baseline: float = 0.0) -> dict[str, Any]:
    """Give the CameraInfo of an eye at some distance, m, from the left one."""
    matrix = camera.matrix
    return {
        "header": stamp(0.0),
        "width": camera.width,
        "height": camera.height,
        "distortion_model": "plumb_bob",
        "d": list(camera.distortion) or [0.0] * 5,
        "k": matrix.ravel().tolist(),
        "r": np.eye(3).ravel().tolist(),
        "p": np.c_[matrix, [-camera.fx * baseline, 0.0, 0.0]].ravel().tolist(),
    }
