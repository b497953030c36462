"""The page of a comparison: the legend of each plot names the colours that are drawn."""

from __future__ import annotations

import re
from pathlib import Path

from helpers.canned_results import canned, write_results

from dvrk_cmaes.evaluate.compared_set import read_compared_set
from dvrk_cmaes.evaluate.comparison import compare_sets
from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.report.compare_page import write_compare_page


def test_legend_has_the_colours_of_the_plot(tmp_path: Path) -> None:
    folders = [write_results(tmp_path / name, canned("0000", 0), canned("0001", k)) for k, name in enumerate("abc")]
    found = compare_sets([read_compared_set(folder) for folder in folders], load_instrument("lnd"))
    page = write_compare_page(tmp_path / "out", found).read_text()
    figures = [part for part in page.split("<figure>")[1:] if 'class="plot"' in part]
    assert figures
    for figure in figures:
        legend, drawing = figure.split("</figcaption>")
        named = dict(re.findall(r'<li><svg class="mark (s\d)[^>]*>.*?</svg> (\w)</li>', legend, flags=re.DOTALL))
        assert list(named) == re.findall(r'<g class="(s\d)">', drawing)
        assert {label: colour for colour, label in named.items()}.items() <= {"A": "s0", "B": "s1", "C": "s2"}.items()
