"""Pages without their pictures, for tests whose subject is what is written beside them: a picture takes some 20 ms.

The pictures themselves are tested in `tests/report`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from dvrk_cmaes import InputError
from dvrk_cmaes.report import template, track_page
from dvrk_cmaes.synth import session

ONE_PIXEL: Final = "data:image/webp;base64,UklGRhoAAABXRUJQVlA4TA0AAAAvAAAAEAcQERGIiP4HAA=="


def _one_pixel(*_: object) -> str:
    return ONE_PIXEL


def _black(path: Path, **_: object) -> np.ndarray:
    """Stand for an image that is read."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    return np.zeros((24, 32, 3), np.uint8)


@contextmanager
def small_overlays() -> Iterator[None]:
    """Let frames be drawn in their own size, not enlarged: a drawing of 320 x 240 px takes a tenth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvrk_cmaes.draw.overlay.SMALLEST", 1)
        yield


@contextmanager
def small_sessions() -> Iterator[None]:
    """Let sessions that are drawn without a camera file have images of 320 x 240 px."""
    camera = session.default_camera
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session, "default_camera", lambda level: camera(level).scaled(320, 240))
        yield


@contextmanager
def plain_pictures() -> Iterator[None]:
    """Let the pictures of pages be of one pixel, without reading those of the results."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (template, track_page):
            patch.setattr(module, "webp", _one_pixel)
        patch.setattr(template, "read_image", _black)
        yield
