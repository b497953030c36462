"""Plain YAML: ``intrinsic`` (3, 3) rows first, ``distortion`` in OpenCV's order; the images' size is not stated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dvrk_cmaes.camera.fields import (
    Intrinsics,
    Side,
    one_camera,
    opencv_distortion,
    refuse_rectified,
    take_field,
    take_matrix,
)


def is_plain(document: Mapping[str, Any]) -> bool:
    """Whether a document has a plain intrinsic matrix."""
    return document.get("intrinsic") is not None


def read_plain(where: str, document: Mapping[str, Any], *, rectified: bool, side: Side) -> Intrinsics:
    """Intrinsics of a plain document; InputError naming the field and what was expected."""
    focal = take_matrix(where, "intrinsic", document["intrinsic"])
    name, entry = take_field(where, document, ("distortion",))
    distortion = opencv_distortion(where, name, entry)
    kind = "plain YAML"
    if rectified:
        refuse_rectified(where, kind, distortion)
        distortion = ("plumb_bob", ())
    images = "rectified images (intrinsic)" if rectified else "raw images (intrinsic and distortion)"
    return Intrinsics(f"{kind}, {images}", None, *focal, *distortion, one_camera(where, side))
