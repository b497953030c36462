"""The bundled demo's files, and the arguments of ``estimate`` for one of its frames."""

from __future__ import annotations

from helpers.places import bundled_path

DEMO = bundled_path("demo")
MASK, IMAGE, CAMERA, JOINTS = (DEMO / p for p in ("masks/0000.png", "images/0000.jpg", "camera.yaml", "joints.csv"))

SMALL_CAMERA = b"width: 64\nheight: 48\nK: [70, 0, 32, 0, 70, 24, 0, 0, 1]\nD: []\n"


def frame(**changes: object) -> list[object]:
    """Give the arguments of ``estimate`` for a good frame, with some replaced."""
    options: dict[str, object] = {"mask": MASK, "camera": CAMERA, "joints": JOINTS, "frame": "0000", **changes}
    return ["estimate", *(part for key, value in options.items() for part in (f"--{key}", value))]
