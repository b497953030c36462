"""The reference page on stability lists the public names, the commands and the exit codes that there are."""

from __future__ import annotations

import re

from helpers.places import ROOT

import dvrk_cmaes
from dvrk_cmaes import DvrkCmaesError, InputError
from dvrk_cmaes.calibration import document
from dvrk_cmaes.cli.app import COMMANDS, app
from dvrk_cmaes.results import result
from dvrk_cmaes.runs import summary

PAGE = (ROOT / "data" / "reference" / "stability.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "data" / "reference" / "results.md").read_text(encoding="utf-8")


def first_paragraph(title: str) -> list[str]:
    """Words in backticks of the first paragraph under a heading, in their order."""
    return re.findall(r"`([\w-]+)`", PAGE.split(f"\n## {title}\n\n")[1].split("\n\n")[0])


def exit_codes(page: str) -> list[int]:
    """Exit codes of the table on a page."""
    table = page.split("| exit code | meaning |\n")[1].split("\n\n")[0]
    return [int(code) for code in re.findall(r"^\| (\d+) \|", table, flags=re.MULTILINE)]


def test_stable_names_are_those_of_the_package() -> None:
    assert first_paragraph("Python") == dvrk_cmaes.__all__


def test_stable_commands_are_those_of_the_program() -> None:
    assert first_paragraph("Commands") == list(COMMANDS)
    assert {name for name in app if not name.startswith("-")} == set(COMMANDS)


def test_schemas_are_those_that_are_written() -> None:
    stated = re.search(r"`schema`, in this version (\d+) of results and `summary.json`, (\d+) of `session.json`", PAGE)
    assert stated is not None
    assert [int(each) for each in stated.groups()] == [result.SCHEMA, document.SCHEMA]
    assert summary.SCHEMA == result.SCHEMA


def test_version_is_that_of_the_changelog_and_of_semantic_versioning() -> None:
    """Between releases, the version is a development one of the next."""
    version = re.fullmatch(r"(\d+)\.(\d+)\.(\d+)(\.dev\d+)?", dvrk_cmaes.__version__)
    assert version is not None
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    entries = re.findall(r"^## (\d+\.\d+\.\d+), (\d{4}-\d\d-\d\d)$", changes, flags=re.MULTILINE)
    released = tuple(int(part) for part in entries[0][0].split("."))
    now = tuple(int(part) for part in version.groups()[:3])
    assert now > released if version[4] else now == released
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {entries[0][0]}\ndate-released: {entries[0][1]}\n" in citation


def test_exit_codes_are_those_of_the_errors_and_of_results() -> None:
    assert exit_codes(PAGE) == exit_codes(RESULTS)
    assert {DvrkCmaesError.exit_code, InputError.exit_code} <= set(exit_codes(PAGE))
