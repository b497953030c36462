"""The layers of a frame's drawing in files: what is written is read again, and what is damaged is refused."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.results.layers import FrameLayers, Outline, read_layers

JPEG = base64.b64encode(b"\xff\xd8\xff and the rest").decode()
LAYERS = FrameLayers(8, 6, (Outline("mask", ((1.0, 1.0, 5.0, 1.0, 5.0, 5.0),)), Outline("result", ())), JPEG)


def test_layers_are_read_as_they_were_written(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", LAYERS.to_dict())
    assert read_layers(tmp_path / "a.json") == LAYERS


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "width: expected a whole number from 1 to 1000000, got 0"),
        ({"picture": "javascript:alert(1)"}, "picture: expected a JPEG file in base64"),
        ({"picture": base64.b64encode(b"<svg/>").decode()}, "picture: expected a JPEG file in base64"),
        ({"outlines": [{"name": "mask", "rings": [[1, 2]]}]}, "expected a list of at least 6 finite numbers"),
        ({"schema": 2}, "schema: expected 1"),
    ],
)
def test_damaged_layers_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    write_json(tmp_path / "a.json", LAYERS.to_dict() | change)
    with pytest.raises(InputError, match=f"a.json: .*{message}"):
        read_layers(tmp_path / "a.json")
