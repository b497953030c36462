"""Curves and points over one pair of axes, as SVG: of all pages, and of the pictures that commands write."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Final
from urllib.parse import quote

import numpy as np

from dvrk_cmaes.geometry import Float64

_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#b04a8f", "#8a7a00", "#6a6f78")
_LEFT, _RIGHT, _BOTTOM, _LEGEND = 58, 12, 44, 18  # px around the axes; height of a row of the legend
_LETTER: Final = 6.6  # px, width of a letter
_MOST_POINTS: Final = 2000  # of a line; of longer ones the extremes of equal parts are drawn
_MARGIN: Final = 0.04  # on each side, as a share of the values' range


@dataclass(frozen=True, eq=False)
class Curve:
    """Values y (N,) over x (N,); NaN in y is a gap.

    points : whether points are drawn instead of a line. frames : names of the frames of the points, to whose entries
    on the page they lead. colour : number of the colour; that of the curve's place by default. faint : drawn in the
    background.
    """

    name: str
    x: Float64
    y: Float64
    points: bool = False
    frames: Sequence[str] = ()
    colour: int | None = None
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Curves over common axes; those without a value are left out.

    across, up : what the axes are, with units. note : a sentence on what is drawn. names : labels of x = 0, 1, ... in
    place of numbers. equal : whether both axes have one scale. least : least length of the vertical axis.
    seeks : whether x counts the frames of the page's player, or is their time.
    """

    title: str
    across: str
    up: str
    curves: Sequence[Curve]
    note: str = ""
    names: Sequence[str] = ()
    equal: bool = False
    least: float = 0.0
    seeks: bool = False

    @property
    def known(self) -> list[Curve]:
        """The curves that have a value, with their colours."""
        return [curve for curve in self.curves if np.isfinite(curve.y).any()]


def anchor(frame: str) -> str:
    """Return the identifier of a frame's entry on a page, in characters that are valid in addresses."""
    return "frame-" + quote(frame, safe="", errors="replace")


def ticks(low: float, high: float, most: int) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``, at most some ``most``."""
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    step = next(power * factor for factor in (1, 2, 5, 10, 20) if (high - low) / (power * factor) <= most)
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def chart_svg(chart: Chart, width: int = 680, height: int = 300) -> str:
    """Draw a chart that has a value, as an SVG element of a size, px, which also is a file by itself."""
    curves = chart.known
    colours = {id(curve): _COLOURS[(k if curve.colour is None else curve.colour) % 6] for k, curve in enumerate(curves)}
    legend, rows = _legend(curves, colours, width) if len(curves) > 1 or curves[0].name else ("", 0)
    left, right, top, bottom = _LEFT, width - _RIGHT, 8 + rows * _LEGEND, height + rows * _LEGEND - _BOTTOM
    x_low, x_high = _range(np.concatenate([curve.x for curve in curves]), 0.0)
    y_low, y_high = _range(np.concatenate([curve.y for curve in curves]), chart.least)
    if chart.equal:
        scale = max((x_high - x_low) / (right - left), (y_high - y_low) / (bottom - top))
        x_low, x_high = _about(x_low, x_high, scale * (right - left))
        y_low, y_high = _about(y_low, y_high, scale * (bottom - top))

    def u(x: Float64) -> Float64:
        return left + (x - x_low) / (x_high - x_low) * (right - left)

    def v(y: Float64) -> Float64:
        return bottom - (y - y_low) / (y_high - y_low) * (bottom - top)

    seeks = f' data-seeks="{x_low:.6g} {x_high:.6g} {left} {right}"' if chart.seeks else ""
    size = f'viewBox="0 0 {width} {bottom + _BOTTOM}" width="{width}" height="{bottom + _BOTTOM}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" {size} role="img"{seeks} font-family="sans-serif" '
        f'font-size="12" fill="currentColor"><title>{escape(chart.title)}</title>{legend}'
    ]
    parts += _axes(chart, (x_low, x_high, left, right), (y_low, y_high, bottom, top))
    for curve in curves:
        parts += _drawn(curve, u(curve.x), v(curve.y), colours[id(curve)])
    return "".join([*parts, "</svg>"])


def stacked(charts: Sequence[Sequence[str]], width: int, height: int) -> str:
    """Return rows of drawings of a size, px, as one SVG file."""
    size = width * max(map(len, charts)), height * len(charts)
    placed = (
        f'<svg x="{width * column}" y="{height * row}" {svg.removeprefix("<svg ")}'
        for row, of_row in enumerate(charts)
        for column, svg in enumerate(of_row)
    )
    ground = f'<rect width="{size[0]}" height="{size[1]}" fill="white"/>'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]} {size[1]}" width="{size[0]}"'
    return f'{head} height="{size[1]}">{ground}{"".join(placed)}</svg>\n'


def _range(values: Float64, least: float) -> tuple[float, float]:
    """Return the ends of an axis: those of the values, with margins."""
    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    return _about(low, high, max((high - low) * (1 + 2 * _MARGIN), least, 1e-9 + 1e-6 * abs(high)))


def _about(low: float, high: float, length: float) -> tuple[float, float]:
    """Return the ends of a range of some length with the same middle."""
    return (low + high - length) / 2, (low + high + length) / 2


def _legend(curves: Sequence[Curve], colours: dict[int, str], width: int) -> tuple[str, int]:
    """Return the names of curves with their colours, and in how many rows they are."""
    parts, at, row = [], _LEFT, 0
    for curve in curves:
        if curve.faint:
            continue
        wide = round(36 + _LETTER * len(curve.name))
        if at + wide > width and at > _LEFT:
            at, row = _LEFT, row + 1
        y = 12 + row * _LEGEND
        mark = f'<circle cx="{at + 8}" cy="{y - 4}" r="4"' if curve.points else f'<path d="M{at} {y - 4}h16"'
        parts.append(f'{mark} stroke="{colours[id(curve)]}" fill="{colours[id(curve)]}" stroke-width="2"/>')
        parts.append(f'<text x="{at + 21}" y="{y}">{escape(curve.name)}</text>')
        at += wide
    return "".join(parts), row + 1


def _axes(chart: Chart, across: tuple[float, float, int, int], up: tuple[float, float, int, int]) -> list[str]:
    """Return grid, labels and names of the axes, each given as its ends and their places."""
    (x_low, x_high, left, right), (y_low, y_high, bottom, top) = across, up
    parts = []
    values = ticks(y_low, y_high, max(2, (bottom - top) // 40))
    for value, text in zip(values, _texts(values), strict=True):
        y = bottom - (value - y_low) / (y_high - y_low) * (bottom - top)
        strong = 0.45 if value == 0 else 0.13
        parts.append(f'<path d="M{left} {y:.1f}H{right}" stroke="currentColor" stroke-opacity="{strong}"/>')
        parts.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
    if chart.names:
        step = max(1, math.ceil(len(chart.names) * (_LETTER * max(map(len, chart.names)) + 12) / (right - left)))
        values = [float(k) for k in range(0, len(chart.names), step)]
        labels = [chart.names[int(k)] for k in values]
    else:
        values = ticks(x_low, x_high, max(2, (right - left) // 80))
        labels = _texts(values)
    for value, text in zip(values, labels, strict=True):
        x = left + (value - x_low) / (x_high - x_low) * (right - left)
        parts.append(f'<path d="M{x:.1f} {bottom}v5" stroke="currentColor"/>')
        parts.append(f'<text x="{x:.1f}" y="{bottom + 18}" text-anchor="middle">{escape(text)}</text>')
    middle = (left + right) / 2, (top + bottom) / 2
    parts.append(f'<path d="M{left} {top}V{bottom}H{right}" fill="none" stroke="currentColor" stroke-opacity="0.5"/>')
    parts.append(f'<text x="{middle[0]}" y="{bottom + 37}" text-anchor="middle">{escape(chart.across)}</text>')
    turned = f'transform="translate(13 {middle[1]}) rotate(-90)" text-anchor="middle"'
    return [*parts, f"<text {turned}>{escape(chart.up)}</text>"]


def _texts(values: Sequence[float]) -> list[str]:
    """Format ticks with as many decimals as their step needs."""
    step = values[1] - values[0] if len(values) > 1 else 1.0
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return [f"{value + 0.0:.{digits}f}" for value in values]


def _drawn(curve: Curve, u: Float64, v: Float64, colour: str) -> list[str]:
    """Return the line or the points of a curve at coordinates (N,)."""
    known = np.isfinite(v)
    if not curve.points:
        shown = _extremes(v)
        lines = "".join(
            f"{'L' if k and known[shown[k - 1]] and known[i] else 'M'}{u[i]:.1f} {v[i]:.1f}"
            for k, i in enumerate(shown)
            if known[i]
        )
        faint = ' stroke-opacity="0.4"' if curve.faint else ""
        return [f'<path d="{lines}" fill="none" stroke="{colour}" stroke-width="1.5"{faint}/>']
    parts = []
    for i in np.flatnonzero(known).tolist():
        point = f'<circle cx="{u[i]:.1f}" cy="{v[i]:.1f}" r="3.2" fill="{colour}"'
        if curve.frames:
            name = curve.frames[i]
            title = f"<title>{escape(name)}: {escape(curve.name)} {curve.y[i]:.4g}</title>"
            parts.append(f'<a href="#{escape(anchor(name))}">{point}>{title}</circle></a>')
        else:
            parts.append(f"{point}/>")
    return parts


def _extremes(values: Float64) -> list[int]:
    """Return the indices of values (N,) that are drawn: all of few, else the extremes and gaps of equal parts."""
    if len(values) <= _MOST_POINTS:
        return list(range(len(values)))
    chosen: set[int] = set()
    for part in np.array_split(np.arange(len(values)), _MOST_POINTS // 2):
        own = values[part]
        chosen.add(int(part[0]) if np.isnan(own).all() else int(part[np.nanargmin(own)]))
        chosen.add(int(part[np.argmax(np.isnan(own))]) if np.isnan(own).any() else int(part[np.argmax(own)]))
    return sorted(chosen)
