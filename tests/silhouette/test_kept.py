"""Prepared meshes in the cache: equal to those prepared anew, and only kept for instruments that are."""

from __future__ import annotations

import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dvrk_cmaes.instrument import Instrument, Link, load_instrument
from dvrk_cmaes.silhouette import kept
from dvrk_cmaes.silhouette.decimate import decimate
from dvrk_cmaes.silhouette.topology import MeshTopology, build_topology


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Set an empty cache folder."""
    monkeypatch.setenv("DVRK_CMAES_CACHE", str(tmp_path / "kept"))
    return tmp_path / "kept"


@pytest.fixture
def instrument(folder: Path) -> Instrument:
    """Load the bundled instrument with the cache."""
    return load_instrument("lnd", use_cache=True)


@pytest.fixture
def count_builds(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Give a list to which each preparation that is not read from the cache is appended."""
    done: list[str] = []

    def counted(name: str) -> Any:
        original = getattr(kept, name)

        def prepare(*arguments: Any) -> Any:
            done.append(name)
            return original(*arguments)

        return prepare

    for name in ("build_topology", "decimate"):
        monkeypatch.setattr(kept, name, counted(name))
    return done


def assert_same(first: MeshTopology, second: MeshTopology) -> None:
    for field in fields(MeshTopology):
        if field.init:
            np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name), err_msg=field.name)
            assert getattr(first, field.name).dtype == getattr(second, field.name).dtype


def test_topology_from_the_cache_equals_a_new_one(instrument: Instrument, count_builds: list[str]) -> None:
    first, second = kept.topology_of(instrument), kept.topology_of(instrument)
    assert count_builds == ["build_topology"]
    assert_same(first, second)
    assert_same(second, build_topology(instrument))


def test_decimated_meshes_from_the_cache_equal_new_ones(instrument: Instrument, count_builds: list[str]) -> None:
    kept.decimated(instrument, 1e-3)
    coarse, error = kept.decimated(instrument, 1e-3)
    assert count_builds == ["decimate"]
    expected, expected_error = decimate(instrument, 1e-3)
    assert error == expected_error
    for link, other in zip(coarse.links, expected.links, strict=True):
        assert link.name == other.name
        np.testing.assert_array_equal(link.vertices, other.vertices)
        np.testing.assert_array_equal(link.faces, other.faces)
    assert coarse.kept
    assert_same(kept.topology_of(coarse), build_topology(expected))


def test_other_cells_and_other_meshes_have_their_own_entries(instrument: Instrument, count_builds: list[str]) -> None:
    kept.decimated(instrument, 1e-3)
    kept.decimated(instrument, 2e-3)
    first, *rest = instrument.links
    moved = replace(instrument, links=(Link(first.name, first.vertices + 1e-6, first.faces), *rest))
    kept.decimated(moved, 1e-3)
    kept.topology_of(moved)
    assert_same(kept.topology_of(instrument), build_topology(instrument))
    assert count_builds == ["decimate"] * 3 + ["build_topology"] * 2


def test_instrument_that_was_loaded_without_the_cache_leaves_no_file(folder: Path, count_builds: list[str]) -> None:
    instrument = load_instrument("lnd")
    for _ in range(2):
        kept.topology_of(instrument)
        kept.decimated(instrument, 1e-3)
    assert len(count_builds) == 4
    assert not folder.exists()


def test_damaged_entries_are_replaced(folder: Path, instrument: Instrument, count_builds: list[str]) -> None:
    kept.topology_of(instrument)
    kept.decimated(instrument, 1e-3)
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[:-100])
    for _ in range(2):
        assert_same(kept.topology_of(instrument), build_topology(instrument))
        kept.decimated(instrument, 1e-3)
    assert count_builds == ["build_topology", "decimate"] * 2


def test_folder_that_cannot_be_written_to_is_tolerated(folder: Path, instrument: Instrument) -> None:
    shutil.rmtree(folder)
    folder.write_text("in the way")
    assert_same(kept.topology_of(instrument), build_topology(instrument))
