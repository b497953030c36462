"""Atomic writing of files: complete or not at all, without leftover temporary files."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from dvrk_cmaes.io import output
from dvrk_cmaes.io.json_file import write_json
from dvrk_cmaes.io.output import whole_file, write_bytes


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_file_mode_follows_umask(tmp_path: Path) -> None:
    mask = os.umask(0o022)
    try:
        write_bytes(tmp_path / "a", b"")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o644


def test_interruption_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(output.os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(tmp_path / "a", b"new")
    assert names(tmp_path) == []


def test_file_of_another_program_is_renamed_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.mp4"
    with whole_file(target, "a video") as made:
        assert (made.parent, made.suffix) == (target.parent, ".mp4")
        made.write_bytes(b"whole")
        assert not target.exists()
    assert target.read_bytes() == b"whole"
    assert names(target.parent) == ["a.mp4"]


def test_file_of_another_program_is_removed_after_an_error(tmp_path: Path) -> None:
    target = tmp_path / "a.mp4"
    target.write_bytes(b"old")

    def fail() -> None:
        with whole_file(target, "a video") as made:
            made.write_bytes(b"half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["a.mp4"]


def test_json_is_indented_and_refuses_nan(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"tip": [1, 2.5], "unit": "°"})
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    assert text == '{\n "tip": [\n  1,\n  2.5\n ],\n "unit": "°"\n}\n'
    assert json.loads(text) == {"tip": [1, 2.5], "unit": "°"}
    with pytest.raises(ValueError, match="Out of range float"):
        write_json(tmp_path / "b.json", {"x": float("nan")})
    assert names(tmp_path) == ["a.json"]
