"""An animated picture (WebP) of a recording that was followed, from the video that `track` wrote."""

from __future__ import annotations

from pathlib import Path

import cv2

from dvrk_cmaes.io.video_writer import quiet_ffmpeg


def moving_picture(tracks: Path, *, width: int, milliseconds: int, quality: int) -> bytes:
    """Encode tracks.mp4 of a folder that `track` wrote as an animated WebP that repeats.

    Parameters
    ----------
    tracks
        The folder.
    width
        Width of the picture, px.
    milliseconds
        Time for which each frame is shown.
    quality
        Quality of the WebP, 0 to 100.
    """
    quiet_ffmpeg()
    capture, images = cv2.VideoCapture(str(tracks / "tracks.mp4")), []
    while True:
        read, image = capture.read()
        if not read:
            break
        size = (width, round(image.shape[0] * width / image.shape[1]))
        images.append(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    animation = cv2.Animation()
    animation.frames, animation.durations, animation.loop_count = images, [milliseconds] * len(images), 0
    written, data = cv2.imencodeanimation(".webp", animation, [cv2.IMWRITE_WEBP_QUALITY, quality])
    assert written
    return bytes(data.tobytes())
