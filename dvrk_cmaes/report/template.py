"""The template of all pages: a summary, figures, curves, and frames with pictures, the worst first, in one file.

A page needs no network. What it refers to is in the same folder. It can be read and printed without scripts; the same
contents give the same bytes.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final
from urllib.parse import quote

import cv2
import jinja2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.draw.canvas import without_strips
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.io.csv_file import Table
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.report.curves import Chart, anchor, chart_svg

EMBEDDED: Final = 1_500_000
"""Size in bytes of embedded pictures from which on others are only referred to."""

_TEMPLATES: Final = Path(__file__).resolve().parent / "templates"
_QUALITY: Final = 50  # of WebP
_PLACE: Final = re.compile(r"^(?:[^:]*(?:/|\.\w{2,5})[^:]*(?::\d+)?: )?(?:frame [^:]*: )?")
"""The path, line and frame at the beginning of a reason."""


@dataclass(frozen=True)
class KeyFigure:
    """A key figure: its name, its value with the unit, and a note."""

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture: its address, or itself as a ``data:`` address, the file that it leads to, and what it shows."""

    source: str
    link: str = ""
    caption: str = ""


@dataclass(frozen=True)
class Entry:
    """A frame on a page: its name and status, lines on it, and details that can be opened.

    seek : the index of its picture in the page's player, None without one.
    """

    name: str
    status: str
    pictures: Sequence[Picture] = ()
    lines: Sequence[str] = ()
    reasons: Sequence[str] = ()
    texts: Sequence[str] = ()
    tables: Sequence[Table] = ()
    document: str = ""
    seek: int | None = None


@dataclass(frozen=True)
class Part:
    """A part of a page under a heading: texts, tables and curves."""

    heading: str
    notes: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[Chart | None] = ()

    @property
    def drawings(self) -> list[tuple[Chart, str]]:
        """The charts that have a value, with their drawings."""
        return [(chart, chart_svg(chart)) for chart in self.charts if chart is not None and chart.known]


@dataclass(frozen=True)
class Player:
    """Pictures of a recording: names, times, s, addresses ("" where an entry has it), statuses; and a file to play."""

    frames: Sequence[str]
    times: Sequence[float]
    pictures: Sequence[str]
    statuses: Sequence[str]
    video: str = ""


@dataclass(frozen=True)
class Page:
    """What a page shows.

    alerts : what concerns all frames. reasons : kinds of reasons, with numbers of frames. first : the part before the
    frames. entries : frames, the worst first. legend : of their pictures.
    """

    title: str
    subtitle: str
    counts: Mapping[str, int] = field(default_factory=dict)
    alerts: Sequence[str] = ()
    notes: Sequence[str] = ()
    figures: Sequence[KeyFigure] = ()
    reasons: Sequence[tuple[str, int]] = ()
    first: Part | None = None
    parts: Sequence[Part] = ()
    entries: Sequence[Entry] = ()
    heading: str = "Frames, the worst first"
    legend: str = "Yellow: the mask. Blue: the outline of the pose."
    player: Player | None = None


def write(path: Path, page: Page) -> Path:
    """Write a page and return its path; errors as in `dvrk_cmaes.io.output.write_bytes`."""
    write_bytes(path, rendered(page).encode("utf-8", errors="replace"))
    return path


def rendered(page: Page) -> str:
    """Return a page as HTML."""
    return _template().render(page=page)


@cache
def _template() -> jinja2.Template:
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style, script = ((_TEMPLATES / name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    made.globals |= {"style": style, "script": script, "hash_of": _hash, "anchor": anchor, "remedy": remedy}
    return made.get_template("page.html")


def remedy(reason: str) -> str:
    """Return what to do about a kind of reason, as the reference page on problems says it; empty if it does not."""
    text = bundled_path("reference", "problems.md").read_text(encoding="utf-8")
    for names, what in re.findall(r"^\| (`.*?) \|.*\| (.*?) \|$", text, re.MULTILINE):
        if reason.startswith(tuple(re.findall(r"`(.+?)(?::.*?)?`", names))):
            return re.sub(r"`|\[|\]\([^)]*\)", "", what)
    return ""


def _hash(text: str) -> str:
    """Return the hash of a script or style for the page's content security policy."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")


class Pictures:
    """Pictures of a folder: within the page up to a size of all together, as addresses of their files beyond it."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._size = folder, 0

    def of(self, path: Path, caption: str = "", widest: int = 960) -> list[Picture]:
        """Return the picture of a file, reduced to ``widest`` px; none if it cannot be read."""
        link = quote(path.relative_to(self._folder).as_posix(), errors="replace")
        if self._size >= EMBEDDED:
            return [Picture(link, link, caption)] if path.is_file() else []
        try:
            data = overlay(path, widest)
        except InputError:
            return []
        self._size += len(data)
        return [Picture(data, link, caption)]


def overlay(path: Path, widest: int) -> str:
    """Return the picture of an overlay's file as `webp`, without its strips of text, which are too small to read."""
    return webp(without_strips(read_image(path)), widest)


def webp(picture: NDArray[np.uint8], widest: int, quality: int = _QUALITY) -> str:
    """Return a picture (H, W, 3) BGR, reduced to ``widest`` px, as a ``data:`` address of WebP."""
    height, width = picture.shape[:2]
    if width > widest:
        size = widest, max(1, round(height * widest / width))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    encoded = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, quality])[1]
    return "data:image/webp;base64," + base64.b64encode(encoded.tobytes()).decode("ascii")


def reason_kind(reason: str) -> str:
    """Return the part of a reason that frames with the same reason share.

    Without the path and the frame's name before it, it is the text before the first colon or semicolon, or, if that is
    one word, such as the name of a field, the text before the first number or value.
    """
    plain = _PLACE.sub("", reason)
    kind = re.split(r"[:;] ", plain, maxsplit=1)[0]
    return kind if " " in kind or plain == reason else re.split(r",? got |[,;(]| [-+\d]", plain, maxsplit=1)[0]


def frames_by_reason(reasons: Iterable[Sequence[str]]) -> list[tuple[str, list[int]]]:
    """Return the kinds of the reasons of frames, most frequent first, and the places of the frames that have each."""
    kinds: dict[str, list[int]] = {}
    for place, of_frame in enumerate(reasons):
        for kind in dict.fromkeys(map(reason_kind, of_frame)):
            kinds.setdefault(kind, []).append(place)
    return sorted(kinds.items(), key=lambda item: (-len(item[1]), item[0]))


def counted_reasons(reasons: Iterable[Sequence[str]]) -> list[tuple[str, int]]:
    """Return the kinds of the reasons of frames and their numbers of frames, most frequent first."""
    return [(kind, len(frames)) for kind, frames in frames_by_reason(reasons)]
