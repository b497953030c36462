"""Masks as JSON: COCO's run lengths and polygons, of one frame or of a whole data set.

Read are ``{"size": [h, w], "counts": ...}``, an annotation with a ``segmentation``, and a data set with ``images``,
``annotations`` and ``categories``, of which the annotations of the frame's image count. Labelme's files, with
``shapes``, are read as well. A label selects annotations by the number or the name of their category; without one, all
count.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

import cv2
import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Bool
from dvrk_cmaes.io.image_header import MOST_PIXELS, check_pixels, foreign
from dvrk_cmaes.io.json_file import read_json, read_json_object
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.rows import number_of

EXPECTED = "a mask as JSON (COCO's run lengths or polygons, or labelme's shapes)"
ROBOFLOW = re.compile(r"_(?:jpe?g|png)\.rf\.[0-9a-zA-Z]+$")
FILES = ("masks.json", "annotations.json", "_annotations.coco.json", "annotations/instances_default.json")
"""Names of a session's file with the masks of all of its frames, the last two those of Roboflow and CVAT."""


def read_coco_mask(path: Path, name: str | None, categories: frozenset[str] | None) -> Bool:
    """Read a mask (H, W) from JSON.

    Parameters
    ----------
    path
        The file.
    name
        Name of the frame, for a data set: that of its image without the suffix.
    categories
        Numbers or names of the categories that count; None for all.

    Raises
    ------
    InputError
        The file is none of these, or a data set without the frame; names the field and what was expected.
    """
    document = read_json(path, expected=EXPECTED)
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected {EXPECTED}, got {foreign(path.read_bytes())}")
    size, parts = _annotations(path, document, name)
    chosen = [part for part, kinds in parts if categories is None or categories & kinds]
    if parts and not chosen:
        there = sorted({kind for _, kinds in parts for kind in kinds})
        got = ", ".join(sorted(categories or ()))
        raise InputError(f"{path}: label: expected one of the categories {listed(there, 10)}, got {got}")
    mask = None if size is None else np.zeros(size, np.bool_)
    for part in chosen:
        drawn = _drawn(path, part, size)
        mask = drawn if mask is None else mask | drawn
    if mask is None:
        raise InputError(f"{path}: expected {EXPECTED}, got the fields {listed(document) or '(none)'}")
    return mask


def frames_of(path: Path) -> list[str]:
    """Return the names of the frames of a data set: those of its images without suffix; empty for other JSON."""
    images = read_json_object(path, expected=EXPECTED).get("images")
    entries = images if isinstance(images, list) else []
    return [_stem(str(entry["file_name"])) for entry in entries if isinstance(entry, Mapping) and "file_name" in entry]


def _annotations(
    path: Path, document: Mapping[str, Any], name: str | None
) -> tuple[tuple[int, int] | None, list[tuple[Any, frozenset[str]]]]:
    """Return height and width, where they are stated, and the segmentations with their categories."""
    if isinstance(document.get("shapes"), list):
        shapes = [shape for shape in document["shapes"] if isinstance(shape, Mapping)]
        size = _size(path, "imageHeight, imageWidth", (document.get("imageHeight"), document.get("imageWidth")))
        return size, [([shape.get("points")], frozenset({str(shape.get("label"))})) for shape in shapes]
    if isinstance(document.get("images"), list):
        return _of_data_set(path, document, name)
    if "counts" in document:
        return _size(path, "size", document.get("size")), [(document, frozenset())]
    if "segmentation" in document:
        stated = document.get("height"), document.get("width")
        known = None if None in stated else _size(path, "height, width", stated)
        return known, [(document["segmentation"], frozenset({str(document.get("category_id"))}))]
    return None, []


def _of_data_set(
    path: Path, document: Mapping[str, Any], name: str | None
) -> tuple[tuple[int, int], list[tuple[Any, frozenset[str]]]]:
    """Return height and width of a frame's image in a data set, and its segmentations with their categories."""
    images = [image for image in document["images"] if isinstance(image, Mapping)]
    stems = {_stem(str(image.get("file_name"))): image for image in images}
    numbered = [stems[one] for one in stems if name is not None and number_of(one) == number_of(name) is not None]
    numbered = numbered if len(numbered) == 1 else images
    image = stems[name] if name in stems else numbered[0] if len(numbered) == 1 else None
    if image is None:
        there = listed(str(image.get("file_name")) for image in images)
        raise InputError(f"{path}: images: expected one of the frame {shown(name)}, got {there or 'none'}")
    kinds = document.get("categories")
    entries = [kind for kind in kinds if isinstance(kind, Mapping)] if isinstance(kinds, list) else []
    names = {kind.get("id"): str(kind.get("name")) for kind in entries}
    parts = [
        (own.get("segmentation"), frozenset({str(own.get("category_id")), names.get(own.get("category_id"), "")}))
        for own in document.get("annotations") or []
        if isinstance(own, Mapping) and own.get("image_id") == image.get("id")
    ]
    return _size(path, "images: height, width", (image.get("height"), image.get("width"))), parts


def _drawn(path: Path, part: Any, size: tuple[int, int] | None) -> Bool:
    """Return the mask (H, W) of a segmentation."""
    if isinstance(part, Mapping):
        stated = _size(path, "size", part.get("size"))
        return _runs(path, part.get("counts"), stated)
    if size is None:
        raise InputError(f"{path}: expected height and width of the image with polygons, got none")
    mask = np.zeros(size, np.uint8)
    for ring in part if isinstance(part, list) else [part]:
        try:
            points = np.asarray(ring, np.float64).reshape(-1, 2)
        except (TypeError, ValueError):
            points = np.zeros((0, 2))
        if len(points) < 3 or not np.isfinite(points).all() or np.abs(points).max() > MOST_PIXELS:
            raise InputError(f"{path}: segmentation: expected polygons x0, y0, x1, y1, x2, y2, ..., got {shown(ring)}")
        # a polygon's coordinates are those of corners of pixels: half a pixel before their centres
        cv2.fillPoly(mask, [np.round((points - 0.5) * 16).astype(np.int32)], 1, shift=4)
    return mask.astype(np.bool_)


def _runs(path: Path, counts: Any, size: tuple[int, int]) -> Bool:
    """Return the mask of run lengths, column by column, the first of background; a text has them compressed."""
    lengths = list(_decompressed(counts)) if isinstance(counts, str) else counts
    whole = isinstance(lengths, list) and all(
        isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in lengths
    )
    if not whole or sum(lengths) != size[0] * size[1]:
        got = f"{sum(lengths)} pixels" if whole else shown(counts)
        raise InputError(f"{path}: counts: expected runs of {size[0] * size[1]} pixels, got {got}")
    values = np.arange(len(lengths)) % 2 == 1
    return np.repeat(values, lengths).reshape(size[::-1]).T


def _decompressed(text: str) -> Iterator[int]:
    """Yield the run lengths of COCO's text: groups of 5 bits from 48 on, each from the third as a difference."""
    before: list[int] = []
    number = shift = 0
    for letter in text:
        code = ord(letter) - 48
        number |= (code & 0x1F) << shift
        shift += 5
        if code & 0x20:
            continue
        if code & 0x10:
            number -= 1 << shift
        number += before[-2] if len(before) > 2 else 0
        before.append(number)
        yield number
        number = shift = 0


def _size(path: Path, field: str, value: Any) -> tuple[int, int]:
    """Return height and width; InputError, which names the field, if they are not those of a picture."""
    pair = list(value) if isinstance(value, list | tuple) else []
    if len(pair) != 2 or not all(isinstance(n, int) and not isinstance(n, bool) and n > 0 for n in pair):
        raise InputError(f"{path}: {field}: expected height and width in pixels, got {shown(value)}")
    check_pixels(f"{path}: {field}", pair[1], pair[0])
    return pair[0], pair[1]


def _stem(name: str) -> str:
    """Return the name of a frame, given that of its image, which may have folders in it, and what Roboflow adds."""
    return ROBOFLOW.sub("", PureWindowsPath(name).stem)
