"""Instruments kept on disk once read and measured: the same again, and only while their files are the same."""

from __future__ import annotations

import shutil
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dvrk_cmaes.instrument import load_instrument, urdf
from dvrk_cmaes.io.bundled import bundled_path


def plain(value: Any) -> Any:
    """An instrument as nested lists."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the bundled instrument, and a place of its own to keep instruments in."""
    monkeypatch.setenv("DVRK_CMAES_CACHE", str(tmp_path / "kept"))
    shutil.copytree(bundled_path("instruments", "lnd"), tmp_path / "lnd")
    return tmp_path


@pytest.fixture
def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """URDF files that were read."""
    read: list[Path] = []

    def reading(path: Path) -> Any:
        read.append(path)
        return original(path)

    original = urdf.read_robot
    monkeypatch.setattr(urdf, "read_robot", reading)
    return read


def test_a_kept_instrument_is_the_one_that_was_read(folder: Path, count_reads: list[Path]) -> None:
    source = folder / "lnd" / "lnd.urdf"
    first = load_instrument(source, keep_measured=True)
    second = load_instrument(source, keep_measured=True)
    assert len(count_reads) == 1
    assert plain(first) == plain(second)
    joints = np.array([0.3, -0.2, 0.5])
    np.testing.assert_array_equal(first.forward(joints), second.forward(joints))


def test_another_mesh_or_urdf_is_read_anew(folder: Path, count_reads: list[Path]) -> None:
    source = folder / "lnd" / "lnd.urdf"
    load_instrument(source, keep_measured=True)
    mesh = next((folder / "lnd" / "meshes").glob("jaw_1*"))
    mesh.write_bytes(mesh.read_bytes() + b"\n")
    load_instrument(source, keep_measured=True)
    source.write_text(source.read_text() + "\n")
    load_instrument(source, keep_measured=True)
    assert len(count_reads) == 3


def test_other_options_are_another_instrument(folder: Path) -> None:
    source = folder / "lnd" / "lnd.urdf"
    thin = load_instrument(source, keep_measured=True, shaft_radius=0.003)
    thick = load_instrument(source, keep_measured=True)
    assert thin.shaft is not None
    assert thick.shaft is not None
    assert thin.shaft.radius == 0.003
    assert thick.shaft.radius > 0.004


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 no archive", b"\x00" * 5000])
def test_a_damaged_file_is_made_anew(folder: Path, count_reads: list[Path], damage: bytes) -> None:
    source = folder / "lnd" / "lnd.urdf"
    load_instrument(source, keep_measured=True)
    (kept,) = (folder / "kept").iterdir()
    kept.write_bytes(damage)
    load_instrument(source, keep_measured=True)
    load_instrument(source, keep_measured=True)
    assert len(count_reads) == 2


def test_nothing_is_kept_unless_asked_nor_where_that_is_off(
    folder: Path, monkeypatch: pytest.MonkeyPatch, count_reads: list[Path]
) -> None:
    source = folder / "lnd" / "lnd.urdf"
    load_instrument(source)
    assert not (folder / "kept").exists()
    monkeypatch.setenv("DVRK_CMAES_CACHE", "off")
    load_instrument(source, keep_measured=True)
    load_instrument(source, keep_measured=True)
    assert len(count_reads) == 3


def test_a_place_that_cannot_be_written_to_is_no_harm(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "file").write_text("in the way")
    monkeypatch.setenv("DVRK_CMAES_CACHE", str(folder / "file"))
    assert load_instrument(folder / "lnd" / "lnd.urdf", keep_measured=True).name == "lnd"
