"""The page of a comparison: the frame that differs most comes first, and the figures say by how much."""

from __future__ import annotations

from pathlib import Path

from helpers.canned_results import canned, write_results
from helpers.page_results import Page

from dvrk_cmaes import load_instrument
from dvrk_cmaes.evaluate.compared_set import read_compared_set
from dvrk_cmaes.evaluate.comparison import compare_sets
from dvrk_cmaes.report.compare_page import write_compare_page


def test_frame_that_differs_most_is_first(tmp_path: Path) -> None:
    folders = [write_results(tmp_path / name, canned("0000", 0), canned("0001", k)) for k, name in enumerate("abc")]
    found = compare_sets([read_compared_set(folder) for folder in folders], load_instrument("lnd"))
    html = write_compare_page(tmp_path / "out", found).read_text(encoding="utf-8")
    page = Page(html)
    assert page.frames == ["0001", "0000"]
    assert html.count('class="chart"') == 2
    for label, off in (("B", 14.21), ("C", 28.87)):
        assert f"{label}: tips off by {off} mm" in page.text
        assert f"{label}: tips from A, median {found.spreads(ord(label) - 65)['tip_mm'].median:.2f} mm" in page.text
        assert f"largest {off} mm (0001)" in page.text
