"""Atomic writing of files: complete or not at all, without leftover temporary files."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.images import read_image, read_mask
from dvrk_cmaes.io import output
from dvrk_cmaes.io.atomic import write_image, write_json, write_text
from dvrk_cmaes.io.output import write_bytes, written_beside


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_parent_folders_are_made(tmp_path: Path) -> None:
    write_text(tmp_path / "out" / "frames" / "größe.txt", "45°\n")
    assert (tmp_path / "out" / "frames" / "größe.txt").read_bytes() == "45°\n".encode()
    assert names(tmp_path / "out" / "frames") == ["größe.txt"]


def test_existing_file_is_replaced(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a", b"old")
    write_bytes(str(tmp_path / "a"), b"new")
    assert (tmp_path / "a").read_bytes() == b"new"
    assert names(tmp_path) == ["a"]


def test_file_mode_follows_umask(tmp_path: Path) -> None:
    mask = os.umask(0o022)
    try:
        write_bytes(tmp_path / "a", b"")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o644


def test_json_is_indented_and_refuses_nan(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"tip": [1, 2.5], "unit": "°"})
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    assert text == '{\n "tip": [\n  1,\n  2.5\n ],\n "unit": "°"\n}\n'
    assert json.loads(text) == {"tip": [1, 2.5], "unit": "°"}
    with pytest.raises(ValueError, match="Out of range float"):
        write_json(tmp_path / "b.json", {"x": float("nan")})
    assert names(tmp_path) == ["a.json"]


def test_written_images_and_masks_are_read_back(tmp_path: Path) -> None:
    colour = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    write_image(tmp_path / "a.PNG", colour)
    assert np.array_equal(read_image(tmp_path / "a.PNG"), colour)
    mask = np.eye(5, dtype=bool)
    write_image(tmp_path / "m.png", mask)
    assert np.array_equal(read_mask(tmp_path / "m.png"), mask)
    write_image(tmp_path / "a.jpg", colour)
    assert cv2.imread(str(tmp_path / "a.jpg")).shape == (6, 8, 3)


def test_unknown_image_extension_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"a\.bmp: expected an image's name to end in .png, .jpg or .jpeg, got '.bmp'$"
    ):
        write_image(tmp_path / "a.bmp", np.zeros((2, 2), np.uint8))
    assert names(tmp_path) == []


def test_unwritable_path_is_refused_without_leftovers(tmp_path: Path) -> None:
    (tmp_path / "folder" / "inside").mkdir(parents=True)
    (tmp_path / "file").write_bytes(b"kept")
    for path, reason in [
        (tmp_path / "folder", "Is a directory"),
        (tmp_path / "file" / "below", "Not a directory"),
        (tmp_path / "file" / "far" / "below", "Not a directory"),
        (tmp_path / ("x" * 300), "File name too long"),
        (tmp_path / "new" / "folder" / ("x" * 300), "File name too long"),
    ]:
        with pytest.raises(InputError) as caught:
            write_bytes(path, b"data")
        assert str(caught.value) == f"{path}: not written ({reason}); expected a place to write a file"
    assert names(tmp_path) == ["file", "folder"]
    assert (tmp_path / "file").read_bytes() == b"kept"


def test_full_disk_leaves_old_file_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_bytes(tmp_path / "a", b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(output.os, "replace", full)
    with pytest.raises(DvrkCmaesError, match=r"a: not written \(No space left on device\)") as caught:
        write_bytes(tmp_path / "a", b"new")
    assert caught.value.exit_code == 1
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"


def test_interruption_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(output.os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(tmp_path / "a", b"new")
    assert names(tmp_path) == []


def test_file_of_another_program_is_renamed_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.mp4"
    with written_beside(target, "a video") as beside:
        assert (beside.parent.parent, beside.suffix) == (target.parent, ".mp4")
        beside.write_bytes(b"whole")
        assert not target.exists()
    assert target.read_bytes() == b"whole"
    assert names(target.parent) == ["a.mp4"]


def test_file_of_another_program_is_removed_after_an_error(tmp_path: Path) -> None:
    target = tmp_path / "a.mp4"
    target.write_bytes(b"old")

    def fail() -> None:
        with written_beside(target, "a video") as beside:
            beside.write_bytes(b"half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["a.mp4"]


def test_file_that_was_not_made_is_an_error(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match=r"a\.mp4: not written .* expected a place to write a video"),
        written_beside(tmp_path / "a.mp4", "a video"),
    ):
        pass


def test_quality_of_a_jpeg_is_chosen(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    write_image(tmp_path / "low.jpg", image, quality=20)
    write_image(tmp_path / "high.jpg", image, quality=90)
    assert (tmp_path / "low.jpg").stat().st_size < 0.5 * (tmp_path / "high.jpg").stat().st_size
