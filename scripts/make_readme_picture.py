"""Write the README's picture data/docs/overlay.jpg: the overlay of one frame of the bundled session, reduced in size.

python scripts/make_readme_picture.py
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.atomic import write_bytes
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.silhouette.prepare import prepare

FRAME = "0001"
WIDTH = 960  # px
QUALITY = 78  # of the JPEG, 0 to 100


def main() -> None:
    """Estimate the frame and write its overlay."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=bundled_path("docs", "overlay.jpg"), help="file to write")
    out = parser.parse_args().out
    session, body = read_session(bundled_path("demo")), prepare("lnd")
    files = next(frame for frame in session.frames if frame.name == FRAME)
    data = read_frame(files, session.camera)
    result = estimate(data.mask, data.camera, files.readings, body, frame=files.name)
    drawn = draw_overlay(result, data.mask, data.camera, body, image=data.image)
    size = (WIDTH, round(drawn.shape[0] * WIDTH / drawn.shape[1]))
    small = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    write_bytes(out, cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())


if __name__ == "__main__":
    main()
