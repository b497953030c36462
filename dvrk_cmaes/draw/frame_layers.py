"""Layers of a frame's drawing: its picture, and the outlines of mask, result and alternatives."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.geometry import Bool, Posed
from dvrk_cmaes.results.layers import FrameLayers, Outline
from dvrk_cmaes.results.result import Alternative, Result, modes_of
from dvrk_cmaes.silhouette import Body, Renderer

_WIDTH = 960  # px, larger pictures are reduced
_QUALITY = 70  # of JPEG
_TOLERANCE = 0.7  # px, largest distance of the simplified outline from that of the pixels
_MOST_RINGS = 200  # the longest are kept; a mask of noise has thousands


def frame_layers(
    result: Result, mask: Bool, camera: Camera, body: Body, *, image: NDArray[np.uint8] | None = None
) -> FrameLayers:
    """Return the layers of a result's drawing.

    Parameters
    ----------
    result
        The estimate; without a pose the only outline is the mask's.
    mask
        (H, W) bool, the instrument.
    camera
        The camera, of the mask's size.
    body
        The instrument, prepared for rendering.
    image
        (H', W', 3) uint8 BGR with the mask's aspect ratio.
    """
    regions = {"mask": mask}
    if result.camera_from_root is not None:
        at = Posed.stacked(modes_of(result, body.instrument.joint_names))
        drawn = Renderer(body, camera, threads=1).masks(at.pose, at.joints)
        regions |= dict(zip(("result", *alternative_names(result.alternatives)), drawn, strict=True))
    height, width = mask.shape
    outlines = tuple(Outline(name, _rings(region)) for name, region in regions.items())
    return FrameLayers(width, height, outlines, None if image is None else _encoded(image))


def alternative_names(alternatives: Sequence[Alternative]) -> tuple[str, ...]:
    """Return the names of alternatives: their relations to the result, numbered from the second of a kind on."""
    names: list[str] = []
    for other in alternatives:
        number = 1 + sum(name.startswith(other.relation) for name in names)
        names.append(other.relation if number == 1 else f"{other.relation} {number}")
    return tuple(names)


def _rings(region: Bool) -> tuple[tuple[float, ...], ...]:
    """Return the outlines of a region (H, W) through the centres of its border's pixels, simplified."""
    rings, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    longest = sorted(rings, key=len, reverse=True)[:_MOST_RINGS]
    simple = (cv2.approxPolyDP(ring, _TOLERANCE, closed=True) for ring in longest)
    return tuple(tuple(map(float, ring.ravel().tolist())) for ring in simple if len(ring) > 2)


def _encoded(image: NDArray[np.uint8]) -> str:
    """Encode a picture as JPEG in base64, reduced to at most `_WIDTH` px."""
    height, width = image.shape[:2]
    if width > _WIDTH:
        size = _WIDTH, max(1, round(height * _WIDTH / width))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    return base64.b64encode(data.tobytes()).decode("ascii")
