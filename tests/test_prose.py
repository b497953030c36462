"""The first screen of reference pages says what to type; their texts and values are those of the program."""

from __future__ import annotations

import re
from importlib import import_module

import pytest
from helpers.places import HELPERS, ROOT

from dvrk_cmaes import EstimateConfig
from dvrk_cmaes.io.toml_file import leaves

PAGES = sorted((ROOT / "data" / "reference").glob("*.md"))
USE = [
    path
    for path in PAGES
    if path.stem in ("accuracy", "arms", "problems", "recordings", "segmentation", "sessions", "tracking", "live")
    or path.stem in ("uncalibrated", "bench", "results", "exports", "testing", "formats", "settings")
]
FIRST_SCREEN = 40  # lines


@pytest.mark.parametrize("page", USE, ids=lambda page: page.stem)
def test_first_screen_has_a_command_and_when_to_trust_what_comes_out(page: object) -> None:
    text = "\n".join(page.read_text(encoding="utf-8").splitlines()[:FIRST_SCREEN])  # type: ignore[attr-defined]
    assert re.search(r"^    (?:\$ )?(?:\S*/)?dvrk-cmaes \w", text, flags=re.MULTILINE)
    assert re.search(r"^\*\*(?:What comes out, and )?[Ww]hen to trust (?:it|a result)\.\*\*", text, flags=re.MULTILINE)


def test_texts_that_the_page_on_problems_names_are_printed_by_the_program() -> None:
    source = " ".join(path.read_text(encoding="utf-8") for path in (ROOT / "dvrk_cmaes").rglob("*.py"))
    source = re.sub(r'"\s+f?"', "", source)
    table = [
        line for line in (ROOT / "data/reference/problems.md").read_text(encoding="utf-8").splitlines() if "|" in line
    ]
    named = {code for line in table for code in re.findall(r"`([^`]+)`", line.split("|")[1])}
    assert len(named) > 20
    patterns = {code: re.sub(r"\b[NM]\b", ".{1,60}?", re.escape(code.removesuffix(": ..."))) for code in named}
    assert [code for code, pattern in patterns.items() if not re.search(pattern, source)] == []


SETTINGS = dict(leaves(EstimateConfig()))
VALUES = [
    line for line in (HELPERS / "page_values.txt").read_text(encoding="utf-8").splitlines() if not line.startswith("#")
]
WORDS = ["half", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]


def number_of(text: str) -> float:
    """Give the number that a page states in digits or as a word."""
    word = text.lower()
    if word in ("half", "twice"):
        return {"half": 0.5, "twice": 2.0}[word]
    return float(WORDS.index(word)) if word in WORDS else float(text.replace(",", ""))


def set_value(source: str) -> float:
    """Give what the program sets: of a setting, of a constant as ``module:NAME``, or its part ``module:NAME.KEY``."""
    if " " in source:
        one, sign, other = source.split()
        return set_value(one) * set_value(other) if sign == "*" else set_value(one) / set_value(other)
    if source in SETTINGS:
        return float(SETTINGS[source])
    module, _, name = source.partition(":")
    if not name:
        return float(source)
    name, *keys = name.split(".")
    values = vars(import_module(f"dvrk_cmaes.{module}"))
    value = values[name if name in values else f"_{name}"]
    for key in keys:
        value = value[int(key) if key.isdigit() else key]
    return float(value)


@pytest.mark.parametrize("line", VALUES)
def test_values_in_pages_are_those_that_the_program_sets(line: str) -> None:
    page, said = line.split(": ", 1)
    words, source = said.split(" => ")
    text = " ".join((ROOT / "data" / "reference" / f"{page}.md").read_text(encoding="utf-8").split())
    before, after = map(re.escape, words.split("{}"))
    found = re.findall(rf"{before}([\w.,-]*\w){after}", text)
    assert len(set(found)) == 1, found
    digits = len(found[0].partition(".")[2])  # as many as the page states
    assert number_of(found[0]) == pytest.approx(set_value(source), rel=0, abs=0.51 * 10**-digits if digits else 1e-9)
