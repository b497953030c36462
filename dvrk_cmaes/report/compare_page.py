"""The page of a comparison of sets of poses, OUT/compare.html, and its figure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate.comparison import Comparison
from dvrk_cmaes.io.short_text import counted
from dvrk_cmaes.report.curves import Chart, Curve
from dvrk_cmaes.report.template import Entry, KeyFigure, Page, Part, Picture, overlay, write
from dvrk_cmaes.results.folder import check_frame_name, overlay_path

PAGE: Final = "compare.html"
_PICTURES: Final = 24  # frames whose overlays are shown
_WIDTH: Final = 480  # px


def write_compare_page(out: Path, comparison: Comparison) -> Path:
    """Write OUT/compare.html and return its path; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    reference, labels = comparison.labels[comparison.reference], comparison.labels
    truth = ", the truth" if comparison.sets[comparison.reference].kind == "truth" else ""
    note = (
        "Tips: mean distance of the tips. Root: distance of the root link's origins. Shaft: angle between the shafts. "
        "Roll: angle about the shaft; from 90° on, the pose is rather that of the mirror twin. Joints: without sign."
    )
    figures = [
        KeyFigure(
            f"{labels[k]} ({comparison.sets[k].path.name}): tips from {reference}, median",
            f"{spread.median:.2f} mm",
            f"largest {spread.largest:.2f} mm ({spread.frame})",
        )
        for k in comparison.others
        if (spread := comparison.spreads(k)["tip_mm"]) is not None
    ]
    page = Page(
        "Comparison of poses",
        f"{counted(len(comparison.frames), 'frame')} · differences from {reference}{truth}",
        figures=figures,
        parts=[
            Part("Sets", tables=[comparison.sets_table()]),
            Part(
                f"Differences from {reference}, all frames",
                notes=[note],
                tables=[comparison.sums_table(k) for k in comparison.others],
                charts=comparison_charts(comparison),
            ),
        ],
        entries=[_entry(comparison, frame, place) for place, frame in enumerate(comparison.by_size)],
        heading="Frames, the largest difference first",
    )
    return write(out / PAGE, page)


def comparison_charts(comparison: Comparison) -> list[Chart]:
    """Chart the tips' distances (of the root, where tips are not known) from the reference, and the overlaps."""
    frames, reference = comparison.frames, comparison.labels[comparison.reference]
    sizes = [{frame: found.size[0] for frame, found in of_set.items()} for of_set in comparison.differences]
    overlaps = [{frame: entry.iou for frame, entry in compared.frames.items()} for compared in comparison.sets]

    def curves(of_sets: Sequence[Mapping[str, float | None]]) -> list[Curve]:
        return [
            Curve(
                comparison.labels[k],
                np.arange(len(frames), dtype=np.float64) + 0.08 * (k - (len(of_sets) - 1) / 2),
                np.array([np.nan if (value := values.get(frame)) is None else value for frame in frames]),
                points=True,
                frames=frames,
                colour=k,
            )
            for k, values in enumerate(of_sets)
        ]

    return [
        Chart(f"Tips from {reference}", "frame", "mm", curves(sizes), names=frames, least=0.1),
        Chart("Overlap", "frame", "IoU", curves(overlaps), names=frames, least=0.02),
    ]


def _entry(comparison: Comparison, frame: str, place: int) -> Entry:
    """Return what the page says of a frame: its differences, and the overlays of the first ones."""
    lines, pictures, status = [], list[Picture](), ""
    for k, compared in enumerate(comparison.sets):
        found = comparison.differences[k].get(frame)
        if place < _PICTURES:
            own = compared.own_names.get(frame, frame)
            pictures += _picture(compared.path, own, f"{comparison.labels[k]}: {compared.path.name}")
        if found is not None:
            status = compared.frames[frame].status or status
            what, size = ("root", found.root_mm) if found.tip_mm is None else ("tips", found.tip_mm)
            lines.append(f"{comparison.labels[k]}: {what} off by {size:.2f} mm, shaft by {found.shaft_deg:.2f} deg")
    return Entry(frame, status, pictures, lines, tables=[comparison.frames_table((frame,))])


def _picture(folder: Path, frame: str, label: str) -> Iterator[Picture]:
    """Yield a frame's overlay, if the folder has one."""
    try:
        check_frame_name(frame)
        yield Picture(overlay(overlay_path(folder, frame), _WIDTH), caption=label)
    except InputError:
        return
