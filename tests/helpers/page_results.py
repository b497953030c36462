"""Results folders for tests of the page, and a parser of pages.

Results are synthetic; overlays are noise between the text strips of real ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np

from dvrk_cmaes import Result
from dvrk_cmaes.draw.panels import footer, header
from dvrk_cmaes.io.json_file import encoded_image
from dvrk_cmaes.report.page import write_page
from dvrk_cmaes.results.result import Alternative, Quality
from dvrk_cmaes.runs.frame import FrameOutcome, write_outcome
from helpers.transforms import exp_rotation, transform

JOINTS = {"wrist_pitch": 0.5, "wrist_yaw": -0.25, "jaw": 0.75}
OUTER = {"yaw": 0.1, "pitch": -0.2, "insertion": 0.15, "roll": 1.0}


def result(name: str, **changes: object) -> Result:
    """Give an ok frame, 100 mm in front of the camera, with readings 0.1 rad too small."""
    pose = transform(exp_rotation([0.3, -0.2, 0.1]), [0.01, -0.02, 0.1])
    one = Result(
        frame=name,
        status="ok",
        reasons=(),
        instrument="lnd",
        root_link="roll_link",
        camera_from_root=pose,
        joints=JOINTS,
        readings={joint: value - 0.1 for joint, value in JOINTS.items()} | OUTER,
        camera_from_base=transform(exp_rotation([0.3, 0.2, 0.1]), [0.06, -0.07, 0.05]),
        quality=Quality(0.96, 0.08, {"mse": 0.05, "dist": 0.03}, 0.6, 2.1),
        covariance=np.diag([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06]) ** 2,
        alternatives=(Alternative(pose, {"wrist_pitch": -0.5}, 0.1, 0.955, "mirror twin", 41.5),),
        seconds=1.5,
        evaluations=1301,
        rays=3210,
        version="1.2.3",
        config={"search": {"method": "cmaes"}},
    )
    return replace(one, **changes)  # type: ignore[arg-type]


def doubtful(name: str, *reasons: str, iou: float = 0.9, near: float | None = None) -> Result:
    """Give a doubtful frame with reasons, whose tips are ``near`` the truth with a probability."""
    quality = Quality(iou, 0.2, {}, 1.5, 6.0)
    return result(name, status="doubtful", reasons=reasons, quality=quality, tip_probability=near)


def failed(name: str, reason: str = "no pose: the mask is empty") -> Result:
    """Give a failed frame."""
    return result(
        name,
        status="failed",
        reasons=(reason,),
        camera_from_root=None,
        camera_from_base=None,
        joints={},
        quality=None,
        covariance=None,
        alternatives=(),
    )


def overlay(one: Result, width: int = 640) -> np.ndarray:
    """Give noise, which hardly compresses, between the text strips of a real overlay."""
    rough = np.random.default_rng(0).integers(0, 255, (width * 3 // 4, width, 3), dtype=np.uint8)
    unit = width / 1280
    above, below = header(one, width, unit), footer(one, width, unit)
    return np.concatenate([above, cv2.blur(rough, (9, 9)), below])


def write_results(out: Path, results: Iterable[Result]) -> Path:
    """Write results as the commands do; returns the folder."""
    for one in results:
        write_outcome(out, FrameOutcome(one, encoded_image("overlay.jpg", overlay(one))))
    return out


class Page(HTMLParser):
    """Parser of a page's text, headings of frames, and addresses."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.frames: list[str] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]
        self._open.append(tag)
        if tag == "h3" and "article" in self._open:
            self.frames.append("")
        if tag in ("meta", "link", "img", "input", "path", "rect", "circle"):
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag in self._open:
            while self._open.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] in ("script", "style"):
            return
        self.words.append(data.strip())
        if "h3" in self._open and "bdi" in self._open and "article" in self._open:
            self.frames[-1] += data

    @property
    def text(self) -> str:
        return " ".join(word for word in self.words if word)


def page_of(out: Path) -> Page:
    """Write the page of a results folder, and parse it."""
    return Page(write_page(out).read_text(encoding="utf-8"))
