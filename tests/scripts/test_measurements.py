"""Measured tables: each states when, where and how it was measured, and the page on accuracy has those of the files."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
from helpers.places import ROOT

FOLDER = ROOT / "data" / "measurements"
FILES = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem != "index")


@pytest.fixture
def measurements(scripts_on_path: None) -> ModuleType:
    """The script."""
    return import_module("measurements")


@pytest.fixture
def tables(scripts_on_path: None) -> ModuleType:
    """The module that reads and adds sections."""
    return import_module("measure.tables")


def test_tables_of_the_page_are_those_of_the_files(measurements: ModuleType) -> None:
    text = measurements.PAGE.read_text(encoding="utf-8")
    assert measurements.with_tables(text) == text, "run python scripts/measurements.py write"


@pytest.mark.parametrize("name", FILES)
def test_every_section_states_date_commit_machine_and_has_whole_rows(tables: ModuleType, name: str) -> None:
    text = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    found = list(tables.sections(text))
    assert len(found) == text.count("\n## ") > 0
    for section in found:
        assert re.match(r"Measured 2026-\d\d-\d\d.*, commits? .+, (on .+|machines in the rows)", section.measured)
        assert len({len(row) for row in section.rows}) == 1, section.title
        assert len(section.rows) > 2


def test_index_names_every_file() -> None:
    text = (FOLDER / "index.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| \[(\w+)\]\((\w+)\.md\)", text, flags=re.MULTILINE) == [
        (name, name) for name in sorted(FILES, key=lambda name: text.index(f"[{name}]"))
    ]


def test_tables_of_a_run_are_added_as_sections(tables: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "rig.md"
    path.write_text("# Rig\n", encoding="utf-8")
    report = {"both eyes": [{"from": "left", "tips, mm": 0.5}, {"from": "right", "tips, mm": None}]}
    tables.record(report, "accuracy.py", ["rig", "a session"], path)
    (section,) = tables.sections(path.read_text(encoding="utf-8"))
    assert section.title.startswith("both eyes, ")
    assert section.measured.endswith(", by `python scripts/accuracy.py rig 'a session'`.")
    assert tables.commit() in section.measured
    assert section.rows == (("from", "tips, mm"), ("---", "---"), ("left", "0.5"), ("right", "-"))


def test_unknown_file_is_refused_before_anything_is_measured(
    tables: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tables.print_report("accuracy.py", dict, as_json=False, kept="rigs") == 2
    assert capsys.readouterr().err.startswith("accuracy.py: --record: expected one of calibration, ")


def test_rows_that_are_missing_are_refused(measurements: ModuleType) -> None:
    with pytest.raises(ValueError, match="expected rows that begin with"):
        measurements.markdown(measurements.Shown("speed", "Times", ("a frame of glass",)))
    with pytest.raises(ValueError, match="expected one section 'Tides'"):
        measurements.section_of(measurements.Shown("speed", "Tides"))
