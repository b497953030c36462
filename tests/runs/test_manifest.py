"""Reading of run.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dvrk_cmaes import InputError
from dvrk_cmaes.runs.manifest import read_manifest

WHOLE = {"version": "1.0.0", "session": "s", "instrument": {"name": "lnd"}, "config": {"seed": 0}, "frames": {}}


def test_folder_without_manifest_has_none(tmp_path: Path) -> None:
    assert read_manifest(tmp_path) is None


def test_manifest_is_read(tmp_path: Path) -> None:
    manifest = {**WHOLE, "frames": {"0000": {"mask": "3f"}, "0001": {}}}
    (tmp_path / "run.json").write_text(json.dumps(manifest))
    assert read_manifest(tmp_path) == manifest


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"frames": None}, "frames: expected an object, got nothing"),
        ({"instrument": []}, "instrument: expected an object, got []"),
        ({"version": 1.5}, "version: expected a text, got 1.5"),
        ({"config": {"trust": []}}, "config.trust: expected an object, got []"),
        (
            {"config": {"trust": {"largest_base_deg": "x"}}},
            "config.trust.largest_base_deg: expected a number above 0, got 'x'",
        ),
        ({"frames": []}, "frames: expected an object, got []"),
        ({"frames": {"0000": 5}}, "frames.0000: expected an object, got 5"),
        ({"frames": {"0000": {"mask": 5}}}, "frames.0000.mask: expected a text, got 5"),
    ],
)
def test_damaged_manifest_is_refused(tmp_path: Path, document: Any, expected: str) -> None:
    path = tmp_path / "run.json"
    path.write_text(json.dumps({**WHOLE, **document}))
    with pytest.raises(InputError) as caught:
        read_manifest(tmp_path)
    assert str(caught.value) == f"{path}: {expected}: choose another --out, or begin anew with --overwrite"
