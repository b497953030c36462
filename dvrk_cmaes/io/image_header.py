"""Read size, bit depth and completeness of PNG and JPEG files without decoding them.

Decoders treat incomplete files differently: some print messages, some fill the missing part with grey. PNG: ISO/IEC
15948, chunks with checksums. JPEG: ITU-T T.81 annex B, an end of the image (EOI) after the last scan (SOS).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import simplejpeg

from dvrk_cmaes.errors import InputError

#: Largest number of pixels of an image that is decoded: above the 33 of 8K; an estimate takes 30 bytes for each.
MOST_PIXELS = 36_000_000

PNG = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {2: 3, 4: 2, 6: 4}  # by colour type; others have one
_OF_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_LAST_FILTER = 4  # of the filters of rows
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
"""First column and row, and steps of columns and rows, of the passes of an interlaced PNG."""


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
        if data.startswith(PNG) and data[12:16] == b"IHDR":
            width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
            header = ImageHeader(width, height, bits, colour == 3, _png_is_whole(data))
        elif data.startswith(b"\xff\xd8"):
            height, width, _, _ = simplejpeg.decode_jpeg_header(data)
            header = ImageHeader(width, height, 8, False, data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda") > 0)
        else:
            return None
    except (struct.error, ValueError, KeyError):  # the last: a sampling of colours that simplejpeg does not know
        return None
    return header if header.width > 0 and header.height > 0 else None


def check_pixels(where: str, width: int, height: int) -> None:
    """Raise an InputError, which begins with ``where``, for an empty picture or one of more than `MOST_PIXELS`."""
    if not 0 < width * height <= MOST_PIXELS:
        least = "at most" if width * height else "1 pixel to"
        raise InputError(f"{where}: expected {least} {MOST_PIXELS // 10**6} megapixels, got {width} x {height}")


def checked_header(data: bytes, where: str, expected: str) -> ImageHeader:
    """Return the header of a whole PNG or JPEG of at most `MOST_PIXELS`; InputError, which begins with ``where``."""
    header = read_header(data)
    if header is None:
        raise InputError(f"{where}: expected {expected}, got {foreign(data)}")
    check_pixels(where, header.width, header.height)
    if not header.whole:
        raise InputError(f"{where}: expected {expected}, got one that is cut off or damaged")
    return header


_FOREIGN = (
    (b"<", b"<annotations", "CVAT's XML: export as COCO 1.0 (masks.json), or Segmentation mask 1.1"),
    (b"[", b'"annotations"', "Label Studio's JSON: export as COCO, or as PNG masks"),
    ((b"II*\0", b"MM\0*"), b"", "a TIFF: save it as PNG"),
    (b"BM", b"", "a BMP: save it as PNG"),
    (b"RIFF", b"WEBP", "a WebP: save it as PNG"),
    (b"GIF8", b"", "a GIF: save it as PNG"),
    ((b"\x93NUMPY", b"PK"), b"", "a NumPy array or an archive: save masks by cv2.imwrite(name, 255 * mask)"),
    (b"NRRD", b"", "a volume of slices: export each slice as PNG"),
    (b"", b'"annotations"', "JSON: give it with the suffix .json"),
)
"""How files of annotators begin, what they have among their first 100,000 bytes, and what to do."""
_POLYGON = re.compile(rb"\d+( \d*\.\d+){6,}\s")


def foreign(data: bytes) -> str:
    """Say what an intact file of an annotator is, and what to export instead of it."""
    if read_header(data) is not None:
        return "a PNG or JPEG by another name: rename it to .png or .jpg"
    start = data[:100_000].lstrip(b"\xef\xbb\xbf \r\n")
    if _POLYGON.match(start):
        return "YOLO's polygons: export as COCO (masks.json), or as PNG masks"
    found = (text for begin, inside, text in _FOREIGN if start.startswith(begin) and inside in start)
    return next(found, "something else or a damaged file")


def _chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield the kind of each chunk of a PNG up to IEND, and where its content begins and ends."""
    position, kind = len(PNG), b""
    while kind != b"IEND" and position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        kind, begin = data[position + 4 : position + 8], position + 8
        yield kind, begin, begin + length
        position = begin + length + 4


def palette_as_grey(data: bytes) -> bytes:
    """Return a whole PNG with a palette as one in grey, whose values are the indices into the palette."""
    parts = [PNG]
    for kind, begin, end in _chunks(data):
        content = data[begin:end]
        if kind == b"IHDR":
            content = content[:9] + b"\0" + content[10:]
        if kind not in (b"PLTE", b"tRNS"):
            parts.append(struct.pack(">I", len(content)) + kind + content + _checksum(kind + content))
    return b"".join(parts)


def _checksum(data: bytes | memoryview) -> bytes:
    return struct.pack(">I", zlib.crc32(data))


def _png_is_whole(data: bytes) -> bool:
    """Whether all chunks up to IEND are complete and have the checksums that they state."""
    view, chunks = memoryview(data), list(_chunks(data))
    whole = all(data[end : end + 4] == _checksum(view[begin - 4 : end]) for _, begin, end in chunks)
    return whole and b"IEND" in [kind for kind, _, _ in chunks]


def checked_png(data: bytes) -> bytes:
    """Return a whole PNG without the chunks that do not change its pixels; ValueError if these are not all there.

    Other files are returned as they are.
    """
    if not data.startswith(PNG):
        return data
    chunks = list(_chunks(data))
    kept = [data[begin - 8 : end + 4] for kind, begin, end in chunks if kind in _OF_PIXELS]
    packed = b"".join(data[begin:end] for kind, begin, end in chunks if kind == b"IDAT")
    width, height, bits, colour, _, _, interlaced = struct.unpack_from(">IIBBBBB", data, 16)
    passes = []  # bytes and number of the rows of each pass
    for left, top, across, down in _ADAM7 if interlaced else ((0, 0, 1, 1),):
        columns, rows = max(0, -(-(width - left) // across)), max(0, -(-(height - top) // down))
        passes.append((1 + (columns * bits * _CHANNELS.get(colour, 1) + 7) // 8 if columns else 0, rows))
    needed, at = sum(size * rows for size, rows in passes), 0
    try:
        pixels = zlib.decompressobj().decompress(packed, needed + 1)
    except zlib.error:
        pixels = b""
    if len(pixels) < needed:
        raise ValueError("not enough image data")
    for size, rows in passes:
        if size and rows and max(pixels[at : at + size * rows : size]) > _LAST_FILTER:
            raise ValueError("a row has no known filter")
        at += size * rows
    return b"".join([PNG, *kept])
