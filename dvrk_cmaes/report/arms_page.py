"""The page of a session with several arms: a table of the arms, which leads to their pages, and common pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.arms_overlay import arm_colours
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.report.page_template import render_template, write_rendered
from dvrk_cmaes.report.page_thumbnails import Thumbnail, encoded_thumbnail
from dvrk_cmaes.results.folder import ResultsFolder
from dvrk_cmaes.results.paths import overlay_path

PAGE: Final = "report.html"
_MOST_PICTURES: Final = 120  # evenly spread over the frames
_WIDTH, _LARGEST = 480, 40_000  # px and bytes of a picture
_RULES: Final = (
    ".swatch { display: inline-block; width: .8em; height: .8em; border-radius: 2px; }",
    ".pictures img { height: auto; aspect-ratio: auto; }",
    ".pictures { --thumb: 20rem; }",
)


@dataclass(frozen=True)
class ArmRow:
    """An arm: name, numbers of frames by status, and figures, each a name, a value and its digits."""

    arm: str
    counts: Mapping[str, int]
    figures: tuple[tuple[str, float | None, int], ...]


@dataclass(frozen=True)
class FramePicture:
    """A frame: its name, its picture with the tools of all arms, the status for each arm, and the picture's file.

    ``file`` is None for a picture that is only in the page.
    """

    frame: str
    picture: Thumbnail
    statuses: Mapping[str, str]
    file: str | None


def write_arms_page(out: Path, folders: Mapping[str, ResultsFolder]) -> Path:
    """Write OUT/report.html and return its path; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    names = sorted({name for folder in folders.values() for name in folder.frames})
    pictures = [picture for name in spread(names) if (picture := _picture(out, name, folders)) is not None]
    return _write_page(out, [_row(arm, folder) for arm, folder in folders.items()], len(names), pictures)


def write_followed_arms_page(
    out: Path, rows: Mapping[str, Sequence[Mapping[str, Any]]], pictures: Sequence[FramePicture]
) -> Path:
    """Write OUT/report.html of followed arms, given the lines of tracks.jsonl by arm, and return its path."""
    names = {row["frame"] for of_arm in rows.values() for row in of_arm}
    return _write_page(out, [_followed_row(arm, of_arm) for arm, of_arm in rows.items()], len(names), pictures)


def _write_page(out: Path, arms: Sequence[ArmRow], frames: int, pictures: Sequence[FramePicture]) -> Path:
    """Write the page of arms that have a number of frames together."""
    colours = [f"#{r:02x}{g:02x}{b:02x}" for b, g, r in arm_colours([row.arm for row in arms]).values()]
    page = render_template(
        "arms.html",
        scripts=("tiles.js", "arms.js"),
        rules=[*_RULES, *(f".arm-{k} {{ background: {colour}; }}" for k, colour in enumerate(colours))],
        arms=arms,
        frames=frames,
        pictures=pictures,
    )
    return write_rendered(out / PAGE, page)


def _row(arm: str, folder: ResultsFolder) -> ArmRow:
    """Summarise the results of an arm."""
    results = folder.frames.values()
    overlaps = [result.quality.iou for result in results if result.quality is not None]
    errors = [result.expected_error.tip_90_mm for result in results if result.expected_error is not None]
    return ArmRow(
        arm,
        {status: sum(result.status == status for result in results) for status in ("ok", "doubtful", "failed")},
        (("IoU, median", _median(overlaps), 3), ("tips within (90 %), median, mm", _median(errors), 2)),
    )


def _followed_row(arm: str, rows: Sequence[Mapping[str, Any]]) -> ArmRow:
    """Summarise the lines of tracks.jsonl of an arm."""
    stds = [row["std"]["tip_mm"] for row in rows if row["std"] is not None and row["std"]["tip_mm"] is not None]
    residuals = [row["residual_px"] for row in rows if row["residual_px"] is not None]
    return ArmRow(
        arm,
        {status: sum(row["status"] == status for row in rows) for status in ("ok", "doubtful", "lost")},
        (("residual, median, px", _median(residuals), 2), ("std of the tips, median, mm", _median(stds), 2)),
    )


def _median(values: Sequence[float]) -> float | None:
    """Return the median of values, None without any."""
    return median(values) if values else None


def spread(names: list[str]) -> list[str]:
    """Return at most ``_MOST_PICTURES`` of the names, evenly spread."""
    count = min(len(names), _MOST_PICTURES)
    return [names[k * len(names) // count] for k in range(count)]


def _picture(out: Path, name: str, folders: Mapping[str, ResultsFolder]) -> FramePicture | None:
    """Return a frame's picture; None if it has none that can be read."""
    path = overlay_path(out, name)
    try:
        picture = encoded_thumbnail(read_image(path), _WIDTH, _LARGEST)
    except InputError:
        return None
    statuses = {arm: folder.frames[name].status for arm, folder in folders.items() if name in folder.frames}
    return FramePicture(name, picture, statuses, f"{path.parent.name}/{path.name}")


def followed_picture(name: str, drawn: NDArray[np.uint8], statuses: Mapping[str, str]) -> FramePicture:
    """Return the small picture of a followed frame that is drawn, (H, W, 3) BGR."""
    return FramePicture(name, encoded_thumbnail(drawn, _WIDTH, _LARGEST), statuses, None)
