"""Read plain YAML: ``intrinsic`` (3, 3) in rows and ``distortion`` in OpenCV's order; the size is not stated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dvrk_cmaes.camera.fields import (
    Intrinsics,
    Side,
    lens_of,
    one_camera,
    opencv_distortion,
    take_field,
    take_matrix,
)


def is_plain(document: Mapping[str, Any]) -> bool:
    """Whether a document has the field ``intrinsic``."""
    return document.get("intrinsic") is not None


def read_plain(where: str, document: Mapping[str, Any], *, rectified: bool, side: Side) -> Intrinsics:
    """Read the intrinsics of a plain document; InputError names the field and what was expected."""
    focal = take_matrix(where, "intrinsic", document["intrinsic"])
    stated = opencv_distortion(where, *take_field(where, document, ("distortion",)))
    kind = "plain YAML"
    distortion = lens_of(where, kind, stated, rectified=rectified)
    images = "rectified images (intrinsic)" if rectified else "raw images (intrinsic and distortion)"
    return Intrinsics(f"{kind}, {images}", None, *focal, *distortion, one_camera(where, side))
