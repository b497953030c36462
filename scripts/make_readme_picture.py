"""Write the README's pictures: data/docs/overlay.jpg, a frame, and data/docs/followed.webp, a followed recording.

    python scripts/make_readme_picture.py

The frame is one of the bundled session. The recording is that of the gallery in which another instrument and a piece of
tissue pass before the one that is followed, in a smaller size.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
from pages.gallery import CAMERA, EXHIBITS
from pages.moving_picture import moving_picture

from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.silhouette.prepare import prepare

FRAME = "0001"
WIDTH = 720  # px
QUALITY = 45  # of the JPEG, 0 to 100

FOLLOWED_WIDTH = 480  # px
FOLLOWED_QUALITY = 18  # of the WebP, 0 to 100
FOLLOWED_EVERY = 4  # of the frames that were followed
FOLLOWED_MS = 200  # between two images


def main() -> None:
    """Write both pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=bundled_path("docs"), help="folder to write to")
    out = parser.parse_args().out
    write_bytes(out / "overlay.jpg", frame_picture())
    write_bytes(out / "followed.webp", recording_picture())


def frame_picture() -> bytes:
    """Estimate the frame and return its overlay, reduced in size, as a JPEG."""
    session, body = read_session(bundled_path("demo")), prepare("lnd")
    files = next(frame for frame in session.frames if frame.name == FRAME)
    data = read_frame(files, session.camera)
    result = estimate(data.mask, data.camera, files.readings, body, frame=files.name)
    drawn = draw_overlay(result, data.mask, data.camera, body, image=data.image)
    size = (WIDTH, round(drawn.shape[0] * WIDTH / drawn.shape[1]))
    small = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())


def recording_picture() -> bytes:
    """Make and follow the recording, and return it as an animated WebP."""
    (hidden,) = (exhibit for exhibit in EXHIBITS if exhibit.title == "A hidden instrument")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "camera.yaml").write_text(CAMERA, encoding="utf-8")
        for command in hidden.commands:
            subprocess.run([sys.executable, "-m", "dvrk_cmaes", *shlex.split(command)], cwd=folder, check=False)
        tracks = Path(folder) / hidden.shown
        shown = {"width": FOLLOWED_WIDTH, "milliseconds": FOLLOWED_MS, "every": FOLLOWED_EVERY}
        return moving_picture(tracks, quality=FOLLOWED_QUALITY, **shown)


if __name__ == "__main__":
    main()
