"""Masks and images: the accepted ways of storing them, and the message for each unusable one."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import match_size, read_ignore, read_image, read_mask

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


def test_values_above_127_are_instrument(tmp_path: Path) -> None:
    pixels = np.array([[0, 1, 127], [128, 254, 255]], np.uint8)
    assert read_mask(stored(tmp_path, pixels)).tolist() == [[False] * 3, [True] * 3]


def test_grey_equal_channel_and_jpeg_masks_are_read(tmp_path: Path) -> None:
    three = np.repeat(grey()[:, :, None], 3, axis=2)
    four = np.dstack([three, np.full(TOOL.shape, 255, np.uint8)])
    for name, pixels in [("a.png", grey()), ("b.png", three), ("c.png", four), ("d.jpg", grey()), ("e.jpeg", three)]:
        mask = read_mask(stored(tmp_path, pixels, name))
        assert mask.dtype == bool
        assert np.array_equal(mask, TOOL)


def test_label_is_selected_by_value(tmp_path: Path) -> None:
    labels = np.zeros((4, 5), np.uint8)
    labels[1], labels[2, :2] = 1, 200
    path = stored(tmp_path, labels)
    assert np.array_equal(read_mask(path, label=1), labels == 1)
    assert np.array_equal(read_mask(path, label=200), labels == 200)
    assert message(path, label=3) == "mask is empty: expected pixels of label 3, got only 0, 1, 200"


def test_picked_component_is_selected(tmp_path: Path) -> None:
    path = stored(tmp_path, grey())
    kept = read_mask(path, pick=(41.4, 30.6))
    assert np.array_equal(kept, TOOL & (np.arange(64) > 30))
    assert message(path, pick=(0, 0)) == "pick: expected a pixel on the instrument, got background at 0,0"
    assert message(path, pick=(64, 0)) == "pick: expected a pixel of the 64 x 48 mask, got 64,0"
    assert message(path, pick=(3, -1)) == "pick: expected a pixel of the 64 x 48 mask, got 3,-1"
    assert message(path, pick=(float("nan"), 1)) == "pick: expected two finite numbers u,v in pixels, got nan,1"


def test_components_are_8_connected(tmp_path: Path) -> None:
    diagonal = np.eye(9, dtype=bool)
    assert np.array_equal(read_mask(stored(tmp_path, grey(diagonal)), pick=(4, 4)), diagonal)


def test_label_and_pick_are_combined(tmp_path: Path) -> None:
    path = stored(tmp_path, TOOL.astype(np.uint8) * 7)
    assert read_mask(path, label=7, pick=(5, 10)).sum() == 100


def test_unicode_file_name_is_read(tmp_path: Path) -> None:
    assert read_mask(stored(tmp_path, grey(), "größe 鉗子.png")).sum() == TOOL.sum()


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
        "expected a mask in grey, of labels by --label 1 or '#00ff00', got a colour image"
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


def test_too_large_image_is_refused_before_decoding(tmp_path: Path) -> None:
    path = tmp_path / "huge.png"
    path.write_bytes(png(100_000, 100_000, 8, 0, b""))
    assert message(path) == "expected at most 36 megapixels, got 100000 x 100000"
    data = bytearray(encoded(grey(), ".jpg"))
    start = data.index(b"\xff\xc0")
    data[start + 5 : start + 9] = struct.pack(">HH", 60_000, 60_000)
    path.write_bytes(data)
    assert message(path) == "expected at most 36 megapixels, got 60000 x 60000"


def test_damaged_files_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "damaged.png"
    broken = "expected a mask (PNG or JPEG), got one that is cut off or damaged"
    other = "expected a mask (PNG or JPEG), got something else or a damaged file"
    data = encoded(np.random.default_rng(0).integers(0, 256, (48, 64), np.uint8))
    for damaged in (data[:-1], data[: len(data) // 2], data[:40], data.replace(b"IDAT", b"IDOT")):
        path.write_bytes(damaged)
        assert message(path) == broken
    for i in range(8 + 8, len(data)):
        path.write_bytes(data[:i] + bytes([data[i] ^ 0x55]) + data[i + 1 :])
        assert message(path) in (broken, other) or "megapixels" in message(path)
    jpeg = encoded(grey(), ".jpg")
    path.write_bytes(jpeg[: len(jpeg) - 30])
    assert message(path) == broken
    for i in range(2, jpeg.index(b"\xff\xc0") + 9, 7):
        path.write_bytes(jpeg[:i])
        assert message(path) == other
    for text in (
        b"\xff\xd8",
        b"\xff\xd8" + b"\xff" * 50,
        b"\xff\xd8\xff\xe0\0\0" * 9,
        b"version https://git",
    ):
        path.write_bytes(text)
        assert message(path) == other
    assert capfd.readouterr() == ("", "")  # the decoders, which print messages, were not called
    path.write_bytes(png(4, 4, 8, 0, b"\0" * 3))
    assert message(path) == "expected a mask (PNG or JPEG), got one that is damaged"
    path.write_bytes(png(0, 4, 8, 0, b""))
    assert message(path) == other


def test_missing_file_and_directory_are_refused(tmp_path: Path) -> None:
    assert message(tmp_path / "none.png") == "no such file; expected a mask (PNG or JPEG)"
    assert message(tmp_path) == "expected a mask (PNG or JPEG), got a directory"
    (tmp_path / "empty.png").touch()
    assert message(tmp_path / "empty.png") == "expected a mask (PNG or JPEG), got an empty file"
    assert message(tmp_path / ("x" * 400)).startswith("not readable (File name too long)")


def test_ignore_mask_may_be_empty_or_full(tmp_path: Path) -> None:
    assert not read_ignore(stored(tmp_path, np.zeros((4, 6), np.uint8))).any()
    assert read_ignore(stored(tmp_path, np.full((4, 6), 128, np.uint8))).all()
    with pytest.raises(
        InputError, match=r"not 8-bit: expected a mask of ignored pixels of 8 bits a pixel, got 16 bits$"
    ):
        read_ignore(stored(tmp_path, np.zeros((4, 6), np.uint16)))


def test_image_is_bgr_and_grey_is_expanded(tmp_path: Path) -> None:
    colour = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    assert np.array_equal(read_image(stored(tmp_path, colour, "i.png")), colour)
    expanded = read_image(stored(tmp_path, grey(), "g.png"))
    assert expanded.dtype == np.uint8
    assert np.array_equal(expanded, np.repeat(grey()[:, :, None], 3, axis=2))
    with pytest.raises(InputError, match=r"none\.jpg: no such file; expected an image \(PNG or JPEG\)$"):
        read_image(tmp_path / "none.jpg")


def test_exif_orientation_is_not_applied(tmp_path: Path) -> None:
    jpeg = encoded(np.zeros((6, 8, 3), np.uint8), ".jpg")
    quarter_turn = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    exif = b"\xff\xe1" + struct.pack(">H", len(quarter_turn) + 2) + quarter_turn
    path = tmp_path / "turned.jpg"
    path.write_bytes(jpeg[:2] + exif + jpeg[2:])
    assert cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR).shape == (8, 6, 3)
    assert read_image(path).shape == (6, 8, 3)


def test_real_masks_and_images_fit_their_cameras(shared: Path) -> None:
    masks = sorted(shared.glob("frames/real/*/masks/*.png"))
    assert len(masks) == 20
    for path in masks:
        mask = read_mask(path)
        assert mask.shape == (480, 640)
        assert 0.01 < mask.mean() < 0.5
        assert read_image(path.parent.parent / "images" / path.name).shape == (480, 640, 3)


def test_published_jpeg_mask_agrees_with_png(shared: Path) -> None:
    soft = read_mask(shared / "formats" / "published_layout" / "0" / "00026.jpg")
    hard = read_mask(shared / "frames" / "real" / "easy" / "masks" / "0026.png")
    assert (soft == hard).mean() > 0.999


VGA = Camera(640, 480, 883.0, 884.0, 445.0, 190.0, (-0.2, 0.1, 0.0, 0.0))


def test_mask_of_calibrated_size_keeps_camera() -> None:
    assert match_size(VGA, (480, 640)) == (VGA, None)


def test_mask_of_same_aspect_rescales_camera_with_note() -> None:
    camera, note = match_size(VGA, (240, 320))
    assert camera == VGA.scaled(320, 240)
    assert note == "the mask is 320 x 240, the calibration 640 x 480: intrinsics rescaled by 0.5"


def test_mask_of_size_rounded_to_whole_pixels_rescales_camera() -> None:
    calibrated = Camera(1400, 986, 1600.0, 1600.0, 700.0, 493.0)
    camera, _ = match_size(calibrated, (51, 72))
    assert camera == calibrated.scaled(72, 51)


def test_mask_of_other_aspect_is_refused() -> None:
    for shape in [(480, 645), (640, 480), (576, 720), (1, 1)]:
        with pytest.raises(InputError) as caught:
            match_size(VGA, shape)
        assert str(caught.value) == (
            f"mask: expected the calibration's size 640 x 480, or one of that aspect, got {shape[1]} x {shape[0]} "
            "(--crop x,y,w,h for a part of the picture, --stretch for one that was resized unevenly)"
        )
