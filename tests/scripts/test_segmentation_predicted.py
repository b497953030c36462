"""``scripts/segmentation.py predicted``: first masks that the other frames of a session predict, counted by image."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
from helpers.page_calibrations import calibration, solved

from dvrk_cmaes.io.atomic import write_json

LEFT = {"a": (0.95, 0.8), "b": (0.9, 1.0)}
RIGHT = {"a": (0.86, 1.2), "b": (0.84, 1.4)}


@pytest.mark.usefixtures("scripts_on_path")
def test_images_are_counted_by_eye(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = replace(
        calibration(solved(("a", "b"))),
        left_out={"c": "no pose"},
        leave_one_out_of_views={"left": LEFT, "right": RIGHT},
    )
    path = tmp_path / "session.json"
    write_json(path, made.to_dict())
    monkeypatch.setattr("sys.argv", ["segmentation.py", "predicted", str(path), "--json"])
    assert import_module("segmentation").main() == 0
    rows = json.loads(capsys.readouterr().out)["predicted"]
    assert [(row["eye"], row["images"], row["iou above 0.85"]) for row in rows] == [
        ("left", 3, 2),
        ("right", 3, 1),
        ("all", 6, 3),
    ]
    assert rows[2]["contour px, median"] == 1.1
    assert rows[1]["iou, least"] == 0.84
