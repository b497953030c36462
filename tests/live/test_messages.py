"""Images in messages: their colours, or their brightness where that is enough."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest

from dvrk_cmaes import InputError
from dvrk_cmaes.live.messages import read_pixels

PIXELS = np.random.default_rng(0).integers(0, 255, (6, 8, 3), dtype=np.uint8)
HEADER = {"stamp": {"sec": 1, "nanosec": 0}}


def compressed(pixels: np.ndarray) -> dict[str, object]:
    data = base64.b64encode(cv2.imencode(".png", pixels)[1].tobytes()).decode()
    return {"header": HEADER, "format": "png", "data": data}


def raw(pixels: np.ndarray) -> dict[str, object]:
    height, width = pixels.shape[:2]
    fields = {"width": width, "height": height, "encoding": "bgr8" if pixels.ndim == 3 else "mono8"}
    step = width * (3 if pixels.ndim == 3 else 1)
    return {"header": HEADER, **fields, "step": step, "data": base64.b64encode(pixels.tobytes()).decode()}


@pytest.mark.parametrize("message", [compressed, raw])
def test_image_is_read_in_colour_or_in_grey(message: object) -> None:
    fields = message(PIXELS)  # type: ignore[operator]
    assert np.array_equal(read_pixels("/image", fields), PIXELS)
    grey = read_pixels("/image", fields, grey=True)
    assert np.abs(grey.astype(int) - cv2.cvtColor(PIXELS, cv2.COLOR_BGR2GRAY)).max() <= 1


def test_jpeg_is_decoded_as_a_file_is_and_a_damaged_one_refused_without_a_word(
    capfd: pytest.CaptureFixture[str],
) -> None:
    jpeg = cv2.imencode(".jpg", np.repeat(np.repeat(PIXELS, 8, axis=0), 8, axis=1))[1]

    def message(data: bytes) -> dict[str, object]:
        return {"header": HEADER, "format": "jpeg", "data": base64.b64encode(data).decode()}

    for grey, flag in ((False, cv2.IMREAD_COLOR), (True, cv2.IMREAD_GRAYSCALE)):
        np.testing.assert_array_equal(
            read_pixels("/image", message(jpeg.tobytes()), grey=grey), cv2.imdecode(jpeg, flag)
        )
    damaged = bytearray(jpeg.tobytes())
    middle = len(damaged) // 2
    damaged[middle : middle + 40] = b"\x00" * 40
    with pytest.raises(InputError, match="/image: expected an image"):
        read_pixels("/image", message(bytes(damaged)))
    assert capfd.readouterr() == ("", "")
