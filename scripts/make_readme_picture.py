"""Write the README's pictures in data/docs: how.png, steps of a frame, overlay.jpg, its result, and followed.webp.

    python scripts/make_readme_picture.py

The frame is one of the bundled session. Result and recording are those of the gallery, smaller; in the recording
another instrument and a piece of tissue pass before the one that is followed.
"""

from __future__ import annotations

import io
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from pages.gallery import EXHIBITS, FOLLOWED, gallery_page, moving_picture
from PIL import Image

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.evidence.gather import gather_evidence
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.geometry import Bool, Indices
from dvrk_cmaes.io.files import bundled_path
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
FOLLOWED_QUALITY = 6  # of the WebP, 0 to 100


def main() -> None:
    """Write the three pictures."""
    docs, exhibits = bundled_path("docs"), {exhibit.shown: exhibit for exhibit in EXHIBITS}
    write_bytes(docs / "how.png", how_picture())
    with tempfile.TemporaryDirectory() as folder:
        work, out = Path(folder, "work"), Path(folder, "out")
        work.mkdir()
        gallery_page(out, work, [exhibits["frame"], exhibits["hidden"]])
        drawn = read_image(out / "frame" / "overlays" / f"{FRAME}.jpg")
        size = (WIDTH, round(drawn.shape[0] * WIDTH / drawn.shape[1]))
        small = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
        jpeg = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
        write_bytes(docs / "overlay.jpg", jpeg.tobytes())
        shown = moving_picture(out / "hidden", width=FOLLOWED_WIDTH, milliseconds=150, quality=FOLLOWED_QUALITY)
        write_bytes(docs / FOLLOWED, shown)


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


if __name__ == "__main__":
    main()
