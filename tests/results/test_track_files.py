"""Lines of tracks.jsonl: what is read back, and damaged fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.track_rows import JOINTS, row

from dvrk_cmaes import InputError
from dvrk_cmaes.results.tracked import line_of, read_tracks


def whole() -> dict[str, Any]:
    std = {"translation_mm": [1, 1, 1], "rotation_deg": [1, 1, 1], "joints_deg": dict.fromkeys(JOINTS, 1), "tip_mm": 1}
    return row(0) | {"std": std}


def written(path: Path, *rows: dict[str, Any]) -> Path:
    path.write_text("".join(line_of(each) for each in rows), encoding="utf-8")
    return path


def test_rows_are_read_as_they_were_written(tmp_path: Path) -> None:
    rows = [whole(), row(1, "lost", "no mask") | {"std": whole()["std"]}, row(2, "lost") | {"camera_from_root": None}]
    rows[2]["std"] = None
    assert read_tracks(written(tmp_path / "tracks.jsonl", *rows)) == rows


def test_rows_of_before_without_newer_fields_are_read(tmp_path: Path) -> None:
    newer = "offsets", "searched", "residual_px", "tip_probability"
    older = {name: value for name, value in whole().items() if name not in newer}
    assert read_tracks(written(tmp_path / "tracks.jsonl", older)) == [older]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("residual_px", "wide"),
        ("tip_probability", "likely"),
        ("offsets", {"roll": "far"}),
        ("searched", "yes"),
        ("status", "fine"),
        ("tips", [[0, 1]]),
    ],
)
def test_damaged_field_is_named_with_its_line(tmp_path: Path, field: str, value: object) -> None:
    path = written(tmp_path / "tracks.jsonl", whole(), whole() | {field: value})
    with pytest.raises(InputError, match=rf"tracks\.jsonl:2: {field}"):
        read_tracks(path)
