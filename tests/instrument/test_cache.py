"""The cache of instruments on disk: equal to a fresh load, and renewed when files or options change."""

from __future__ import annotations

import shutil
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.instrument_files import TETRA_OBJ, gripper, write_urdf
from helpers.places import bundled_path

from dvrk_cmaes import load_instrument
from dvrk_cmaes.instrument import urdf


def plain(value: Any) -> Any:
    """Convert an instrument to nested lists."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a small instrument with a mesh, and set an empty cache folder."""
    monkeypatch.setenv("DVRK_CMAES_CACHE", str(tmp_path / "kept"))
    box, mesh = '<box size="0.009 0.004 0.004"/>', '<mesh filename="meshes/wrist.obj" scale="0.009 0.004 0.004"/>'
    small = gripper()
    assert small.count(box) == 1
    write_urdf(tmp_path / "small", small.replace(box, mesh), "small.urdf")
    (tmp_path / "small" / "meshes").mkdir()
    (tmp_path / "small" / "meshes" / "wrist.obj").write_text(TETRA_OBJ, encoding="utf-8")
    return tmp_path


@pytest.fixture
def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Give a list to which each URDF file that is read is appended."""
    read: list[Path] = []

    def reading(path: Path) -> Any:
        read.append(path)
        return original(path)

    original = urdf.read_robot
    monkeypatch.setattr(urdf, "read_robot", reading)
    return read


def test_cached_instrument_equals_loaded(folder: Path, count_reads: list[Path]) -> None:
    source = Path(shutil.copytree(bundled_path("instruments", "lnd"), folder / "lnd")) / "lnd.urdf"
    first = load_instrument(source, use_cache=True)
    second = load_instrument(source, use_cache=True)
    assert len(count_reads) == 1
    assert plain(first) == plain(second)
    joints = np.array([0.3, -0.2, 0.5])
    np.testing.assert_array_equal(first.forward(joints), second.forward(joints))


def test_changed_mesh_or_urdf_is_read_again(folder: Path, count_reads: list[Path]) -> None:
    source = folder / "small" / "small.urdf"
    load_instrument(source, use_cache=True)
    mesh = folder / "small" / "meshes" / "wrist.obj"
    mesh.write_bytes(mesh.read_bytes() + b"\n")
    load_instrument(source, use_cache=True)
    source.write_text(source.read_text() + "\n")
    load_instrument(source, use_cache=True)
    assert len(count_reads) == 3


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 no archive", b"\x00" * 5000])
def test_damaged_entry_is_replaced(folder: Path, count_reads: list[Path], damage: bytes) -> None:
    source = folder / "small" / "small.urdf"
    load_instrument(source, use_cache=True)
    (kept,) = (folder / "kept").iterdir()
    kept.write_bytes(damage)
    load_instrument(source, use_cache=True)
    load_instrument(source, use_cache=True)
    assert len(count_reads) == 2


def test_package_that_is_nearer_is_found_after_it_was_added(folder: Path) -> None:
    urdf, far, near = folder / "small" / "small.urdf", folder / "parts", folder / "small" / "parts"
    urdf.write_text(urdf.read_text().replace("meshes/wrist.obj", "package://parts/wrist.obj"))
    shutil.copytree(folder / "small" / "meshes", far)
    before = load_instrument(urdf, use_cache=True)
    shutil.copytree(far, near)
    (near / "wrist.obj").write_text(TETRA_OBJ.replace("v 1 0 0", "v 0.9 0 0"), encoding="utf-8")
    after = load_instrument(urdf, use_cache=True)
    assert plain(after) == plain(load_instrument(urdf)) != plain(before)


def test_cache_is_optional(folder: Path, monkeypatch: pytest.MonkeyPatch, count_reads: list[Path]) -> None:
    source = folder / "small" / "small.urdf"
    load_instrument(source)
    assert not (folder / "kept").exists()
    monkeypatch.setenv("DVRK_CMAES_CACHE", "off")
    load_instrument(source, use_cache=True)
    load_instrument(source, use_cache=True)
    assert len(count_reads) == 3


def test_unwritable_cache_folder_is_tolerated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "file").write_text("in the way")
    monkeypatch.setenv("DVRK_CMAES_CACHE", str(folder / "file"))
    assert load_instrument(folder / "small" / "small.urdf", use_cache=True).name == "test"
