"""The page of a session with several arms: a table of the arms, which leads to their pages, and common pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

from dvrk_cmaes.draw.arms_overlay import arm_colours
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.io.atomic import write_bytes
from dvrk_cmaes.report.page_template import render_template
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
    """An arm: name, colour of its drawing, numbers of frames by status, medians, and the address of its page."""

    arm: str
    colour: str
    counts: Mapping[str, int]
    iou: float | None
    tip_90_mm: float | None
    page: str


@dataclass(frozen=True)
class FramePicture:
    """A frame: its name, its picture with the tools of all arms, the status for each arm, and the picture's file."""

    frame: str
    picture: Thumbnail
    statuses: Mapping[str, str]
    file: str


def write_arms_page(out: Path, folders: Mapping[str, ResultsFolder]) -> Path:
    """Write OUT/report.html and return its path; errors as in `dvrk_cmaes.io.atomic.write_bytes`."""
    colours = {arm: f"#{r:02x}{g:02x}{b:02x}" for arm, (b, g, r) in arm_colours(list(folders)).items()}
    names = sorted({name for folder in folders.values() for name in folder.frames})
    page = render_template(
        "arms.html",
        scripts=("tiles.js", "arms.js"),
        rules=[*_RULES, *(f".arm-{k} {{ background: {colour}; }}" for k, colour in enumerate(colours.values()))],
        arms=[_row(arm, folder, colours[arm]) for arm, folder in folders.items()],
        frames=len(names),
        pictures=[one for name in _spread(names) if (one := _picture(out, name, folders)) is not None],
    )
    path = out / PAGE
    write_bytes(path, page.encode("utf-8", errors="replace"))
    return path


def _row(arm: str, folder: ResultsFolder, colour: str) -> ArmRow:
    """Summarise the results of an arm."""
    results = folder.frames.values()
    overlaps = [result.quality.iou for result in results if result.quality is not None]
    errors = [result.expected_error.tip_90_mm for result in results if result.expected_error is not None]
    return ArmRow(
        arm,
        colour,
        {status: sum(result.status == status for result in results) for status in ("ok", "doubtful", "failed")},
        median(overlaps) if overlaps else None,
        median(errors) if errors else None,
        f"{arm}/{PAGE}",
    )


def _spread(names: list[str]) -> list[str]:
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
