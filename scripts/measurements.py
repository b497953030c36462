"""Measured tables of data/measurements, and the page data/reference/accuracy.md, whose tables are taken from them.

    python scripts/measurements.py write                     # writes the tables of the page
    python scripts/accuracy.py rig SESSION... --record rig_and_arms    # adds the tables of a run to a file

A file has sections of one table each, under a line that says when, of which commit, on which machine and by which
command it was measured. ``--record`` of the scripts ``accuracy.py``, ``bench.py`` and ``segmentation.py`` adds such a
section for each table that they print, with their own command line, which names the sessions and seeds. The page shows
the parts of sections that ``TABLES`` names.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from measure.tables import FOLDER, Section, sections

from dvrk_cmaes.io.atomic import write_text

ROOT: Final = Path(__file__).resolve().parents[1]
PAGE: Final = ROOT / "data" / "reference" / "accuracy.md"


class Shown(NamedTuple):
    """A part of a section that the page shows: rows by the beginnings of their first cells (none: all), and columns."""

    file: str
    title: str
    rows: tuple[str, ...] = ()
    columns: tuple[int, ...] = ()


TABLES: Final[Mapping[str, tuple[Shown, ...]]] = {
    "sessions": (Shown("calibration", "Made sessions of ten frames"),),
    "recordings solved together": (Shown("calibration", "Recordings not used before, every fourth frame"),),
    "halves": (
        Shown(
            "calibration",
            "Halves of a session",
            ("0617", "synth, 16 frames, seeds 710", "another program, hard 621"),
        ),
    ),
    "followed": (Shown("recordings", "By the window of images"),),
    "clocks": (Shown("clocks_and_cables", "Made recordings of two seconds"),),
    "cables": (Shown("clocks_and_cables", "Cables of a real arm"),),
    "both eyes": (Shown("rig_and_arms", "Five sessions of both eyes", (), (0, 1, 2, 3)),),
    "tools that cross": (Shown("rig_and_arms", "Tools that cross", ("with the other tool", "alone")),),
    "worlds": (Shown("frames", "Worlds of every kind"),),
    "falsified": (Shown("frames", "Falsified frames"),),
    "mistakes": (Shown("frames", "Mistakes of users"),),
    "segmentation": (Shown("segmentation", "The paper's real images"),),
    "times": (Shown("speed", "Times"),),
    "live": (Shown("recordings", "Live"),),
}
"""Tables of the page, by the names of their places."""


def table(shown: tuple[Shown, ...]) -> str:
    """Return the tables of a place of the page, each with the line that says when and how it was measured."""
    return "\n\n".join(f"{markdown(one)}\n\n{section_of(one).measured}" for one in shown)


def section_of(shown: Shown) -> Section:
    """Return the section that is shown; ValueError if there is not exactly one of that title."""
    path = FOLDER / f"{shown.file}.md"
    found = [one for one in sections(path.read_text(encoding="utf-8")) if one.title == shown.title]
    if len(found) != 1:
        raise ValueError(f"{path}: expected one section {shown.title!r}, got {len(found)}")
    return found[0]


def markdown(shown: Shown) -> str:
    """Lay out the rows and columns that are shown; ValueError if a row is missing."""
    head, _, *rows = section_of(shown).rows
    missing = [name for name in shown.rows if not any(row[0].startswith(name) for row in rows)]
    if missing:
        raise ValueError(f"{shown.file}.md: {shown.title}: expected rows that begin with {missing}")
    chosen = [row for row in rows if not shown.rows or row[0].startswith(shown.rows)]
    columns = shown.columns or tuple(range(len(head)))
    cells = [head, ("---",) * len(head), *chosen]
    return "\n".join("".join(f"| {row[k]} " if row[k] else "| " for k in columns) + "|" for row in cells)


def with_tables(page: str) -> str:
    """Replace what is between the marked lines of the page; ValueError if a place is not marked."""
    for name, shown in TABLES.items():
        begin, end = f"<!-- measured {name}: made by scripts/measurements.py -->", f"<!-- end of measured {name} -->"
        pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        if not pattern.search(page):
            raise ValueError(f"expected the lines {begin} and {end}")
        text = f"{begin}\n{table(shown)} {end}"
        page = pattern.sub(lambda _, t=text: t, page)  # type: ignore[misc]
    return page


def main() -> int:
    """Write the tables of the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("write",))
    parser.parse_args()
    write_text(PAGE, with_tables(PAGE.read_text(encoding="utf-8")))
    return 0


if __name__ == "__main__":
    sys.exit(main())
