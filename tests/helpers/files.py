"""Files that tests write and read by other means than the program's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np


def write_text(path: str | Path, text: str) -> None:
    """Write a text, in folders that need not exist."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def write_json(path: str | Path, document: Any) -> None:
    """Write plain values as JSON, in folders that need not exist."""
    write_text(path, json.dumps(document, indent=1, allow_nan=False) + "\n")


def write_image(path: str | Path, image: np.ndarray) -> None:
    """Write an image or a mask (bool: 0 and 255), in folders that need not exist."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = image.astype(np.uint8) * 255 if image.dtype == bool else image
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())


def read_image(path: str | Path) -> np.ndarray:
    """Read an image as (H, W, 3) BGR."""
    return _decoded(path, cv2.IMREAD_COLOR)


def read_tracks(path: str | Path) -> list[dict[str, Any]]:
    """Read the lines of tracks.jsonl."""
    return [json.loads(line) for line in Path(path).read_text(encoding="utf-8").splitlines()]


def read_mask(path: str | Path) -> np.ndarray:
    """Read a mask (H, W) bool: pixels above 127 are instrument."""
    return _decoded(path, cv2.IMREAD_GRAYSCALE) > 127


def _decoded(path: str | Path, mode: int) -> np.ndarray:
    pixels = cv2.imdecode(np.frombuffer(Path(path).read_bytes(), np.uint8), mode | cv2.IMREAD_IGNORE_ORIENTATION)
    assert pixels is not None, path
    return np.asarray(pixels)
