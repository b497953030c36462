"""Masks and images: the accepted ways of storing them, and the message for each unusable one."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes import Camera, InputError
from dvrk_cmaes.frames.images import match_size, read_image, read_mask

TOOL = np.zeros((48, 64), bool)
TOOL[10:20, 5:15] = True
TOOL[30:40, 40:60] = True


def encoded(pixels: np.ndarray, extension: str = ".png") -> bytes:
    return cv2.imencode(extension, pixels)[1].tobytes()


def stored(folder: Path, pixels: np.ndarray, name: str = "mask.png") -> Path:
    path = folder / name
    path.write_bytes(encoded(pixels, path.suffix))
    return path


def grey(mask: np.ndarray = TOOL) -> np.ndarray:
    return mask.astype(np.uint8) * 255


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(width: int, height: int, bits: int, colour: int, rows: bytes, *more: bytes) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(more) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def message(path: Path, label: int | None = None, pick: tuple[float, float] | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_mask(path, label=label, pick=pick)
    text = str(caught.value)
    assert "\n" not in text
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def test_jpeg_with_a_sampling_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    path, data = tmp_path / "mask.jpg", bytearray(encoded(np.dstack([grey()] * 3), ".jpg"))
    first = data.index(b"\xff\xc0") + 11  # sampling factors of the first component
    data[first] = 0x14
    path.write_bytes(data)
    assert message(path).startswith("expected ")


def test_components_are_8_connected(tmp_path: Path) -> None:
    diagonal = np.eye(9, dtype=bool)
    assert np.array_equal(read_mask(stored(tmp_path, grey(diagonal)), pick=(4, 4)), diagonal)


def test_empty_or_full_mask_is_refused(tmp_path: Path) -> None:
    assert message(stored(tmp_path, np.zeros((4, 4), np.uint8))) == (
        "mask is empty: expected pixels above 127 on the instrument, got none (the largest value is 0)"
    )
    assert message(stored(tmp_path, np.eye(4, dtype=np.uint8))) == (
        "mask is empty: expected pixels above 127 on the instrument, got none "
        "(the largest value is 1; of labels, say which: --label 1, or --label any)"
    )
    assert message(stored(tmp_path, np.full((4, 4), 255, np.uint8))) == (
        "mask is full: expected background around the instrument, got none"
    )


def test_mask_of_other_bit_depth_is_refused(tmp_path: Path) -> None:
    path = stored(tmp_path, grey().astype(np.uint16) * 257)
    assert message(path) == "not 8-bit: expected a mask of 8 bits a pixel, got 16 bits (--label any takes them)"
    path.write_bytes(png(8, 2, 2, 0, b"\0\xff\0\0\x0f\0"))
    assert message(path) == "not 8-bit: expected a mask of 8 bits a pixel, got 2 bits (--label any takes them)"


def test_mask_of_single_bits_is_read(tmp_path: Path) -> None:
    path = tmp_path / "mask.png"
    path.write_bytes(png(8, 2, 1, 0, b"\0\xf0\0\x0f"))
    assert read_mask(path).astype(int).tolist() == [[1, 1, 1, 1, 0, 0, 0, 0], [0, 0, 0, 0, 1, 1, 1, 1]]
    assert np.array_equal(read_mask(path, label=1), read_mask(path))


def test_colour_or_transparent_mask_is_refused(tmp_path: Path) -> None:
    colour = np.zeros((4, 4, 3), np.uint8)
    colour[1, 1, 2] = 255
    assert message(stored(tmp_path, colour)) == (
        "expected a mask in grey, of labels by --label 1 or '#00ff00' (of a session: label of a [[tool]] in "
        "session.toml), got the colours #000000, #ff0000"
    )
    clear = np.dstack([np.repeat(grey()[:, :, None], 3, axis=2), grey()])
    assert (
        message(stored(tmp_path, clear)) == "expected a mask in grey, got an image with transparency: save it without"
    )


def test_label_of_a_palette_is_its_index(tmp_path: Path) -> None:
    path = tmp_path / "palette.png"
    palette = chunk(b"PLTE", bytes([0, 0, 0, 5, 5, 5, 255, 255, 255]))
    path.write_bytes(png(3, 2, 8, 3, b"\0\0\1\2\0\0\0\0", palette))
    assert read_mask(path).tolist() == [[False, False, True], [False] * 3]
    assert read_mask(path, label=1).tolist() == [[False, True, False], [False] * 3]
    assert read_mask(path, label="any").tolist() == [[False, True, True], [False] * 3]
    path.write_bytes(png(4, 2, 2, 3, b"\0\x1b\0\0", palette))
    assert read_mask(path, label=2).tolist() == [[False, False, True, False], [False] * 4]


def test_exif_orientation_is_not_applied(tmp_path: Path) -> None:
    jpeg = encoded(np.zeros((6, 8, 3), np.uint8), ".jpg")
    quarter_turn = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    exif = b"\xff\xe1" + struct.pack(">H", len(quarter_turn) + 2) + quarter_turn
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg[:2] + exif + jpeg[2:])
    assert cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR).shape == (8, 6, 3)
    assert read_image(path).shape == (6, 8, 3)


VGA = Camera(640, 480, 883.0, 884.0, 445.0, 190.0, (-0.2, 0.1, 0.0, 0.0))


def test_mask_of_same_aspect_rescales_camera_with_note() -> None:
    camera, note = match_size(VGA, (240, 320))
    assert camera == VGA.scaled(320, 240)
    assert note == "the mask is 320 x 240, the calibration 640 x 480: intrinsics rescaled by 0.5"


def test_mask_of_size_rounded_to_whole_pixels_rescales_camera() -> None:
    calibrated = Camera(1400, 986, 1600.0, 1600.0, 700.0, 493.0)
    camera, _ = match_size(calibrated, (51, 72))
    assert camera == calibrated.scaled(72, 51)
