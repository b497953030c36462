"""The layers of a frame's drawing, for pages on which each can be shown by itself: ``OUT/layers/<frame>.json``.

They are the picture, the outline of the mask, and the outlines of the silhouettes of the result and its alternatives.
"""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.typed_document import Number, check_schema, convert_document, present_fields, refused

SCHEMA = 1

_Ring = Annotated[tuple[Number, ...], Meta(min_length=6, description="a list of at least 6 finite numbers")]
_Size = Annotated[int, Meta(ge=1, le=1_000_000, description="a whole number from 1 to 1000000")]
_JPEG = b"\xff\xd8\xff"


@dataclass(frozen=True)
class Outline:
    """The outline of a region: its name, and closed rings of u, v, u, v, ... in px; holes are rings, too.

    The name is ``mask``, ``result``, or the relation of an alternative to the result, as ``mirror twin``.
    """

    name: str
    rings: tuple[_Ring, ...]


@dataclass(frozen=True)
class FrameLayers:
    """Layers of a frame of ``width`` x ``height`` px: its outlines, and its picture as JPEG in base64, if it has one.

    Pixel centres are at integers. The picture may have another size than the frame, with the same aspect ratio.
    """

    width: _Size
    height: _Size
    outlines: tuple[Outline, ...]
    picture: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the document of the layers, ready for JSON."""
        outlines = [
            {"name": outline.name, "rings": [list(ring) for ring in outline.rings]} for outline in self.outlines
        ]
        size = {"width": self.width, "height": self.height}
        return {"schema": SCHEMA, **size, "outlines": outlines, "picture": self.picture}


def read_layers(path: str | Path) -> FrameLayers:
    """Read the layers of a frame.

    Raises
    ------
    InputError
        The file cannot be read, or a field is wrong; the message names both.
    """
    where = str(path)
    document = present_fields(where, read_json_object(Path(path), expected="the layers of a frame's drawing"))
    check_schema(where, document, SCHEMA)
    layers = convert_document(where, document, FrameLayers)
    if layers.picture is not None and not _is_jpeg(layers.picture):
        raise refused(where, "picture", "a JPEG file in base64", layers.picture)
    return layers


def _is_jpeg(text: str) -> bool:
    try:
        return base64.b64decode(text, validate=True).startswith(_JPEG)
    except (binascii.Error, ValueError):  # ValueError: not ASCII
        return False
