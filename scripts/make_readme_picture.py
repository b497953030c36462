"""Write the README's pictures in data/docs: how.png, steps of a frame, overlay.jpg, its result, and followed.webp.

    python scripts/make_readme_picture.py

The frame is one of the bundled session. The recording is that of the gallery in which another instrument and a piece of
tissue pass before the one that is followed, in a smaller size.
"""

from __future__ import annotations

import argparse
import io
import shlex
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from pages.gallery import CAMERA, EXHIBITS
from pages.moving_picture import moving_picture
from PIL import Image

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.draw.overlay import draw_overlay
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import Bool, Indices
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.joints.prior import split_readings
from dvrk_cmaes.pose.search.global_search import find_candidates, search_size
from dvrk_cmaes.pose.search.starts import draw_starts
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.prepare import body_by, decimated_body, prepare

FRAME = "0001"
WIDTH = 720  # px
QUALITY = 45  # of the JPEG, 0 to 100

PANEL = (144, 196)  # px
SHOWN = (0.45, 0.0, 1.0, 1.0)  # left, top, right and bottom of the part that is shown, as shares of the image
LOOKAT = 8  # candidates that are shown, of those drawn in the LookAt space
COLOURS = ((38, 38, 44), (214, 214, 214), (230, 120, 60), (70, 140, 230))  # of none, both, mask alone, silhouette alone

FOLLOWED_WIDTH = 960  # px
FOLLOWED_QUALITY = 4  # of the WebP, 0 to 100
FOLLOWED_MS = 80  # between two images


def main() -> None:
    """Write all pictures, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=bundled_path("docs"), help="folder to write to")
    parser.add_argument("--only", choices=PICTURES, help="write one of them")
    options = parser.parse_args()
    for name in [options.only] if options.only else PICTURES:
        write_bytes(options.out / name, PICTURES[name]())


def how_picture() -> bytes:
    """Return the steps of the frame as a PNG: mask, candidates, best of them, what CMA-ES found, refined pose."""
    session, body = read_session(bundled_path("demo")), prepare("lnd")
    files = next(frame for frame in session.frames if frame.name == FRAME)
    data, config = read_frame(files, session.camera), EstimateConfig(threads=1)
    evidence = gather_evidence(data.mask, data.camera, body.instrument)
    readings, _, _ = split_readings(body.instrument, files.readings, config)
    coarse = body_by(decimated_body(body, config.search.detail_m), config.silhouette.method)
    renderer = Renderer(coarse, data.camera, threads=1)
    size = search_size(evidence, config.search.width_px)
    mask = evidence.at_size(*size)[0] > 0.5
    drawn, _ = draw_starts(evidence, body.instrument, readings, config, np.random.default_rng(config.seed))
    outlines = np.zeros((data.camera.height, data.camera.width), dtype=np.uint8)
    for silhouette in renderer.masks(drawn.pose[-LOOKAT:], drawn.joints[-LOOKAT:]):
        edges = cv2.findContours(silhouette.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        cv2.drawContours(outlines, edges, -1, 1, 2)
    unsearched = replace(config, search=replace(config.search, evaluations=1))
    starts, found = (find_candidates(renderer, evidence, readings, each)[0] for each in (unsearched, config))
    in_search = [renderer.at(*size).masks(one[0].at.pose, one[0].at.joints) for one in (starts, found)]
    result = estimate(data.mask, data.camera, files.readings, body, config=config)
    assert result.camera_from_root is not None
    refined = Renderer(body, data.camera, threads=1).masks(result.camera_from_root, result.joints)
    panels = [
        _panel(data.mask, data.mask),
        np.where(_cropped(outlines > 0), 3, _panel(data.mask, data.mask)),
        *(_panel(mask, silhouette) for silhouette in in_search),
        _panel(data.mask, refined),
    ]
    indices = np.pad(np.concatenate([np.pad(each, ((0, 0), (0, 4))) for each in panels], axis=1)[:, :-4], 2)
    image = Image.fromarray(indices.astype(np.uint8), mode="P")
    image.putpalette([value for colour in COLOURS for value in colour])
    written = io.BytesIO()
    image.save(written, "PNG", optimize=True, bits=2)
    return written.getvalue()


def _panel(mask: Bool, silhouette: Bool) -> Indices:
    """Return the indices of colours of a mask and a silhouette: none of both, both, the mask alone, the other alone."""
    a, b = _cropped(mask), _cropped(silhouette)
    return np.select([a & b, a, b], [1, 2, 3], 0)


def _cropped(image: Bool) -> Bool:
    """Return the shown part of an image of any size, in the panel's size."""
    left, top, right, bottom = (round(end * size) for end, size in zip(SHOWN, image.shape[::-1] * 2, strict=True))
    part = image[top:bottom, left:right].astype(np.uint8)
    return np.asarray(cv2.resize(part, PANEL, interpolation=cv2.INTER_NEAREST) > 0)


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
    """Make the recording, follow all of its frames, and return it as an animated WebP."""
    (hidden,) = (exhibit for exhibit in EXHIBITS if exhibit.title == "A hidden instrument")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "camera.yaml").write_text(CAMERA, encoding="utf-8")
        for command in hidden.commands:
            subprocess.run(
                [sys.executable, "-m", "dvrk_cmaes", *shlex.split(command.replace("--every 2 ", ""))],
                cwd=folder,
                check=False,
            )
        tracks = Path(folder) / hidden.shown
        return moving_picture(tracks, width=FOLLOWED_WIDTH, milliseconds=FOLLOWED_MS, quality=FOLLOWED_QUALITY)


PICTURES = {"how.png": how_picture, "overlay.jpg": frame_picture, "followed.webp": recording_picture}

if __name__ == "__main__":
    main()
