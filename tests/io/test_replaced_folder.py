"""A folder that takes the place of an earlier one when it is whole."""

from __future__ import annotations

from pathlib import Path

import pytest
from dvrk_cmaes.io.atomic_folder import replaced_folder

from dvrk_cmaes.io import atomic_folder


@pytest.fixture
def old(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    (folder / "alone").mkdir(parents=True)
    (folder / "alone" / "a.json").write_text("kept")
    (folder / "session.json").write_text("old")
    return folder


@pytest.mark.parametrize("in_one_step", [True, False])
def test_new_folder_takes_the_place_with_what_is_kept(
    old: Path, monkeypatch: pytest.MonkeyPatch, in_one_step: bool
) -> None:
    if not in_one_step:
        monkeypatch.setattr(atomic_folder, "_RENAME_EXCHANGE", -1)  # no such flag
    with replaced_folder(old, kept=("alone",)) as beside:
        (beside / "session.json").write_text("new")
        assert (old / "session.json").read_text() == "old"
    assert (old / "session.json").read_text() == "new"
    assert (old / "alone" / "a.json").read_text() == "kept"
    assert [path.name for path in old.parent.iterdir()] == ["out"]


def test_failure_leaves_the_earlier_folder(old: Path) -> None:
    def fail() -> None:
        with replaced_folder(old) as beside:
            (beside / "session.json").write_text("half")
            raise ValueError("half written")

    with pytest.raises(ValueError, match="half written"):
        fail()
    assert (old / "session.json").read_text() == "old"
    assert [path.name for path in old.parent.iterdir()] == ["out"]


def test_folder_that_is_not_there_is_made(tmp_path: Path) -> None:
    with replaced_folder(tmp_path / "a" / "b") as beside:
        (beside / "x").write_text("x")
    assert (tmp_path / "a" / "b" / "x").read_text() == "x"
