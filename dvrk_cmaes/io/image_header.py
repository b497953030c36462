"""Read size, bit depth and completeness of PNG and JPEG files without decoding them.

Decoders treat incomplete files differently: some print messages, some fill the missing part with grey. PNG: ISO/IEC
15948, the IHDR chunk. JPEG: ITU-T T.81 annex B, the frame header that follows a SOF marker.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

#: Largest number of pixels of an image that is decoded: above the 33 of 8K; an estimate takes 30 bytes for each.
MOST_PIXELS = 36_000_000

_PNG = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {2: 3, 4: 2, 6: 4}  # by colour type; others have one
_LAST_FILTER = 4  # of the filters of rows
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""First column and row, and steps of columns and rows, of the passes of an interlaced PNG."""

_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # those three are tables and a reserved code
_WITHOUT_LENGTH = frozenset({0x01, *range(0xD0, 0xD9)})  # JPEG markers that stand alone


@dataclass(frozen=True)
class ImageHeader:
    """Properties of an image file: size in pixels and bits per channel.

    ``palette``: pixels are indices into a palette. ``whole``: the file is complete.
    """

    width: int
    height: int
    bits: int
    palette: bool
    whole: bool


def read_header(data: bytes) -> ImageHeader | None:
    """Read the header of a PNG or JPEG file; None for other files and for an invalid header."""
    try:
        if data.startswith(_PNG) and data[12:16] == b"IHDR":
            width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
            header = ImageHeader(width, height, bits, colour == 3, _png_is_whole(data))
        elif data.startswith(b"\xff\xd8"):
            header = _read_jpeg(data)
        else:
            return None
    except (struct.error, IndexError):
        return None
    return header if header.width > 0 and header.height > 0 else None


def palette_as_grey(data: bytes) -> bytes:
    """Return a whole PNG with a palette as one in grey, whose values are the indices into the palette."""
    position, parts = len(_PNG), [_PNG]
    while position < len(data):
        (length,) = struct.unpack_from(">I", data, position)
        kind, content = data[position + 4 : position + 8], data[position + 8 : position + 8 + length]
        position += 12 + length
        if kind == b"IHDR":
            content = content[:9] + b"\0" + content[10:]
        if kind not in (b"PLTE", b"tRNS"):
            parts.append(struct.pack(">I", length) + kind + content + struct.pack(">I", zlib.crc32(kind + content)))
        if kind == b"IEND":
            break
    return b"".join(parts)


def _png_is_whole(data: bytes) -> bool:
    """Whether all chunks up to IEND are complete and have the checksums that they state."""
    view, position = memoryview(data), len(_PNG)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 8 + length
        if end + 4 > len(data) or struct.unpack_from(">I", data, end)[0] != zlib.crc32(view[position + 4 : end]):
            return False
        if data[position + 4 : position + 8] == b"IEND":
            return True
        position = end + 4
    return False


def checked_png(data: bytes) -> bytes:
    """Return a whole PNG without the chunks that do not change its pixels; ValueError if these are not all there.

    Other files are returned as they are.
    """
    if not data.startswith(_PNG):
        return data
    kept, packed, position = [_PNG], [], len(_PNG)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        kind, end = data[position + 4 : position + 8], position + 12 + length
        if kind in (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"):
            kept.append(data[position:end])
        if kind == b"IDAT":
            packed.append(data[position + 8 : end - 4])
        position = end
    width, height, bits, colour, _, _, interlaced = struct.unpack_from(">IIBBBBB", data, 16)
    passes = []  # bytes and number of the rows of each pass
    for left, top, across, down in _ADAM7 if interlaced else ((0, 0, 1, 1),):
        columns, rows = max(0, -(-(width - left) // across)), max(0, -(-(height - top) // down))
        passes.append((1 + (columns * bits * _CHANNELS.get(colour, 1) + 7) // 8 if columns else 0, rows))
    needed, at = sum(size * rows for size, rows in passes), 0
    try:
        pixels = zlib.decompressobj().decompress(b"".join(packed), needed + 1)
    except zlib.error:
        pixels = b""
    if len(pixels) < needed:
        raise ValueError("not enough image data")
    for size, rows in passes:
        if size and rows and max(pixels[at : at + size * rows : size]) > _LAST_FILTER:
            raise ValueError("a row has no known filter")
        at += size * rows
    return b"".join(kept)


def _read_jpeg(data: bytes) -> ImageHeader:
    """Read the segments of a JPEG up to its frame header."""
    position = 2
    while data[position] == 0xFF:
        while data[position] == 0xFF:
            position += 1
        marker, position = data[position], position + 1
        if marker in _SOF:
            bits, height, width = struct.unpack_from(">BHH", data, position + 2)
            return ImageHeader(width, height, bits, False, data.rfind(b"\xff\xd9", position) > 0)
        if marker not in _WITHOUT_LENGTH:
            (length,) = struct.unpack_from(">H", data, position)
            position += length
    raise IndexError("no marker where a segment should begin")
