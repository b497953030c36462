"""Full pictures within the page: which are, up to which size, and what becomes of damaged ones."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.page_results import doubtful, page_of, result, write_results

from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.report import page as page_module
from dvrk_cmaes.report.page_layers import embedded_layers, embedded_picture, outline_path, size_of_layers
from dvrk_cmaes.results.layers import FrameLayers, Outline
from dvrk_cmaes.results.paths import layers_path, overlay_path

SQUARE = (1.0, 1.0, 5.0, 1.0, 5.0, 5.0, 1.0, 5.0)


def full_pictures(out: Path) -> list[bool]:
    """Tell for each frame in the page's order whether its overlay is within the page."""
    page = (page_of(out), (out / "report.html").read_text(encoding="utf-8"))[1]
    bodies = page.split('<div class="stage">')[1:]
    return ['src="data:image/webp' in body.split("</a>")[0] for body in bodies]


def test_overlays_are_within_the_page_up_to_a_limit_most_doubtful_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = write_results(tmp_path, [result("a"), result("b"), doubtful("c", "far: jaw")])
    assert full_pictures(out) == [True, True, True]
    size = len(embedded_picture(overlay_path(out, "c")) or "")
    monkeypatch.setattr(page_module, "EMBEDDED", size)
    assert full_pictures(out) == [True, False, False]


def test_outline_becomes_closed_path_from_the_corner_of_the_first_pixel(tmp_path: Path) -> None:
    layers = FrameLayers(8, 6, (Outline("mask", ()), Outline("result", (SQUARE, SQUARE))))
    write_json(layers_path(tmp_path, "a"), layers.to_dict())
    drawn = embedded_layers(layers_path(tmp_path, "a"))
    assert drawn == layers
    path = 2 * "M1.5 1.5L5.5 1.5 5.5 5.5 1.5 5.5z"
    assert [outline_path(outline) for outline in drawn.outlines] == ["", path]
    assert size_of_layers(drawn) == len(path)


def test_mask_without_pixels_has_no_outline_in_the_page(tmp_path: Path) -> None:
    out = write_results(tmp_path, [result("a")])
    layers = FrameLayers(8, 6, (Outline("mask", ()), Outline("result", (SQUARE,))))
    write_json(layers_path(out, "a"), layers.to_dict())
    page_of(out)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert (page.count('class="outline o1" data-part="1"'), page.count('data-layer="1"')) == (1, 1)
    assert (page.count('class="outline o0"'), page.count('data-layer="0"')) == (0, 0)


def test_page_does_without_damaged_pictures(tmp_path: Path) -> None:
    out = write_results(tmp_path, [result("a")])
    write_json(layers_path(out, "a"), {"schema": 1, "width": 8, "height": 6, "outlines": [{"name": "<script>"}]})
    page = page_of(out)
    assert "svg" not in page.tags[page.tags.index("article") :] or "<script>" not in page.text
    assert embedded_layers(layers_path(out, "a")) is None
    overlay_path(out, "a").write_bytes(b"no picture")
    assert embedded_picture(overlay_path(out, "a")) is None
    assert page_of(out).frames == ["a"]
