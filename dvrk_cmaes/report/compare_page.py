"""The HTML page of a comparison of results: summary, plots over the frames, and the frames that differ most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.comparison import QUANTITIES, Comparison, count_statuses, median_of
from dvrk_cmaes.report.page_template import render_template, write_rendered
from dvrk_cmaes.report.page_thumbnails import Thumbnail, thumbnail
from dvrk_cmaes.report.plots.axes import name_axis, value_axis
from dvrk_cmaes.report.plots.panels import SHAPES, Mark, Panel, Plot, Series, mark_size
from dvrk_cmaes.results.file import read_result
from dvrk_cmaes.results.paths import check_frame_name, overlay_path, result_path

PAGE: Final = "compare.html"
_PICTURES: Final = 24  # frames whose overlays are shown


def write_compare_page(out: Path, comparison: Comparison) -> Path:
    """Write OUT/compare.html and return its path; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    reference = comparison.labels[comparison.reference]
    tips = [{frame: found.tip_mm for frame, found in differences.items()} for differences in comparison.differences]
    overlaps = [{frame: entry.iou for frame, entry in compared.frames.items()} for compared in comparison.sets]
    plots = (
        _plot("tips", f"tips from {reference}, mm", comparison, tips, least=0.1, from_zero=True),
        _plot("overlap", "overlap (IoU)", comparison, overlaps, least=0.02),
    )
    page = render_template(
        "compare.html",
        comparison=comparison,
        quantities=_headings(comparison),
        spreads={label: comparison.spreads(k) for k, label in enumerate(comparison.labels)},
        statuses=[count_statuses(compared) for compared in comparison.sets],
        overlaps=[median_of(iter(of_frames.values())) for of_frames in overlaps],
        plots=[plot for plot in plots if plot is not None],
        pictures=_pictures(comparison),
    )
    return write_rendered(out / PAGE, page)


def _headings(comparison: Comparison) -> dict[str, str]:
    """Return the headings of the quantities that differ, the joints after the others, by name."""
    names = dict.fromkeys(name for k in comparison.others for name in comparison.spreads(k))
    return {name: QUANTITIES.get(name, f"{name.removesuffix('_deg')}, deg") for name in names}


def _plot(
    name: str,
    label: str,
    comparison: Comparison,
    of_sets: Sequence[Mapping[str, float | None]],
    *,
    least: float,
    from_zero: bool = False,
) -> Plot | None:
    """Plot the values by frame of each set; the vertical axis has at least the span ``least``; None without any."""
    frames = comparison.frames
    values = {
        k: {place: v for place, frame in enumerate(frames) if (v := by_frame.get(frame)) is not None}
        for k, by_frame in enumerate(of_sets)
    }
    known = [value for by_place in values.values() for value in by_place.values()]
    if not known:
        return None
    low, high = 0.0 if from_zero else min(known), max(known)
    across = name_axis(frames, start=72, end=708)
    up = value_axis(label, low, max(high, low + least), start=276, end=14)
    step = min(0.15 * (across.at(1) - across.at(0)), 8.0)  # sets beside each other
    series = tuple(
        Series(
            comparison.labels[k],
            SHAPES[k % len(SHAPES)],
            tuple(
                Mark(place, across.at(place) + (k - (len(values) - 1) / 2) * step, up.at(value), True)
                for place, value in by_place.items()
            ),
            colour=k,
        )
        for k, by_place in values.items()
        if by_place
    )
    return Plot(name, mark_size(len(frames)), (Panel(720, 330, across, up, series),))


def _pictures(comparison: Comparison) -> dict[str, dict[str, Thumbnail | None]]:
    """Read the pictures of the frames that differ most, by frame and label of the set."""
    paths = {label: compared.path for label, compared in zip(comparison.labels, comparison.sets, strict=True)}
    frames = comparison.by_size[:_PICTURES]
    chosen = {frame: {label: _picture(path, frame) for label, path in paths.items()} for frame in frames}
    return {frame: pictures for frame, pictures in chosen.items() if any(pictures.values())}


def _picture(folder: Path, frame: str) -> Thumbnail | None:
    """Read a thumbnail of a frame's overlay; None if the folder has none."""
    try:
        check_frame_name(frame)
        return thumbnail(overlay_path(folder, frame), read_result(result_path(folder, frame)))
    except InputError:
        return None
