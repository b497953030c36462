"""Curves as SVG: ticks, gaps, names, links, one scale, and long recordings."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from dvrk_cmaes.report.curves import Chart, Curve, chart_svg


def drawn(*curves: Curve, **more: object) -> ElementTree.Element:
    return ElementTree.fromstring(chart_svg(Chart("t", "x", "y", curves, **more)))  # type: ignore[arg-type]


def line_of(svg: ElementTree.Element) -> str:
    (line,) = (path.get("d") for path in svg.iterfind(".//{*}path") if path.get("stroke-width") == "1.5")
    assert line is not None
    return line


def test_points_are_where_their_values_are_and_lead_to_their_frames() -> None:
    curve = Curve("a", np.array([0.0, 1.0, 2.0]), np.array([0.0, 5.0, 10.0]), points=True, frames=("p", "q<", "r"))
    svg = drawn(curve, Curve("b", np.array([0.0]), np.array([np.nan])))
    links = list(svg.iterfind(".//{*}a"))
    assert [link.get("href") for link in links] == ["#frame-p", "#frame-q%3C", "#frame-r"]
    points = [[float(point.get(name, "")) for name in ("cx", "cy")] for point in svg.findall(".//{*}a/{*}circle")]
    assert np.diff(points, axis=0)[0] == pytest.approx(np.diff(points, axis=0)[1], abs=0.11)
    assert points[0][1] > points[2][1]
    labels = {
        float(text.text): float(text.get("y", "")) - 4
        for text in svg.iterfind(".//{*}text")
        if text.get("text-anchor") == "end"
    }
    assert labels[10] == pytest.approx(points[2][1], abs=0.11)


def test_gap_is_no_line() -> None:
    x, y = np.arange(5.0), np.array([0.0, 1.0, np.nan, 3.0, 4.0])
    assert len(re.findall("M", line_of(drawn(Curve("a", x, y))))) == 2


def test_long_curve_keeps_its_extremes_and_gaps() -> None:
    y = np.zeros(20_000)
    y[7001], y[12_345:12_400] = 9.0, np.nan
    line = line_of(drawn(Curve("", np.arange(20_000.0), y)))
    assert len(line) < 60_000
    heights = [float(point) for point in re.findall(r"[ML]\S+ (\S+?)(?=[ML]|$)", line)]
    assert min(heights) < 100 < max(heights)
    assert line.count("M") >= 2


def test_names_that_have_no_room_are_left_out_and_texts_are_escaped() -> None:
    names = [f"<frame> {k:04d}" for k in range(500)]
    svg = drawn(Curve("&", np.arange(500.0), np.ones(500)), names=names)
    shown = [text.text for text in svg.iterfind(".//{*}text") if (text.text or "").startswith("<frame>")]
    assert 2 < len(shown) < 12
    assert shown[0] == names[0]
