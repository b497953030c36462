"""An animated picture (WebP) of a recording that was followed, from the video and the statuses that `track` wrote."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.io.video_writer import quiet_ffmpeg

Image = NDArray[np.uint8]

_STRIP: Final = 22  # px, height of the strip with the status above each image
_COLOURS: Final = {"ok": (130, 210, 110), "doubtful": (70, 210, 240), "lost": (90, 110, 240)}  # BGR


def moving_picture(tracks: Path, *, width: int, milliseconds: int, quality: int) -> bytes:
    """Encode the frames of a folder that `track` wrote as an animated WebP that repeats.

    Parameters
    ----------
    tracks
        The folder, with tracks.mp4, and tracks.jsonl, of several arms in a folder for each.
    width
        Width of the picture, px.
    milliseconds
        Time for which each frame is shown.
    quality
        Quality of the WebP, 0 to 100.
    """
    said = _statuses(tracks)
    images = [_labelled(image, *of, width) for image, of in zip(_frames(tracks / "tracks.mp4"), said, strict=True)]
    animation = cv2.Animation()
    animation.frames = images
    animation.durations = [milliseconds] * len(animation.frames)
    animation.loop_count = 0
    written, data = cv2.imencodeanimation(".webp", animation, [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert written
    return bytes(data.tobytes())


def _frames(video: Path) -> Iterator[Image]:
    """Yield the images of a video, (H, W, 3) BGR."""
    quiet_ffmpeg()
    capture = cv2.VideoCapture(str(video))
    while True:
        read, image = capture.read()
        if not read:
            return
        yield np.asarray(image, np.uint8)


def _statuses(tracks: Path) -> list[tuple[str, str]]:
    """Return the status and a text of each frame; of several arms, the worst status and those of all."""
    if (tracks / "tracks.jsonl").is_file():
        return [_said(frame) for frame in _lines(tracks)]
    arms = sorted(path.parent for path in tracks.glob("*/tracks.jsonl"))
    of_frames = zip(*([frame["status"] for frame in _lines(arm)] for arm in arms), strict=True)
    worst = [*_COLOURS].index
    return [
        (max(said, key=worst), ", ".join(f"{arm.name} {one}" for arm, one in zip(arms, said, strict=True)))
        for said in of_frames
    ]


def _lines(tracks: Path) -> list[dict[str, Any]]:
    """Return the lines of tracks.jsonl in a folder."""
    return [json.loads(line) for line in (tracks / "tracks.jsonl").read_text(encoding="utf-8").splitlines()]


def _said(frame: dict[str, Any]) -> tuple[str, str]:
    """Return the status of a frame, and a text of it with its first reason up to the colon."""
    reasons = [reason.partition(":")[0] for reason in frame["reasons"]]
    return frame["status"], ": ".join([frame["status"], *reasons[:1]])


def _labelled(image: Image, status: str, text: str, width: int) -> Image:
    """Reduce an image of the video, whose own strip of text is covered by one that is readable at this size."""
    size = (width, round(image.shape[0] * width / image.shape[1]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    small[:_STRIP] = 24
    cv2.putText(small, text, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _COLOURS[status], 1, cv2.LINE_AA)
    return np.asarray(small, np.uint8)
