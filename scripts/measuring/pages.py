"""The marked tables of README.md and pages of data/reference, from figures.json, measurements and experiments.

A file of data/measurements has sections of one table each, under a line that says when, of which commit, on which
machine and by which command it was measured. Pages show the parts of sections that ``SHOWN`` names, and the errors of
single frames by level of data/figures.json.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import write_text
from measuring.report import MEASUREMENTS, ROOT, markdown

README: Final = ROOT / "README.md"
ACCURACY: Final = ROOT / "data" / "reference" / "accuracy.md"
EXPERIMENTS: Final = ROOT / "data" / "reference" / "experiments.md"
PAPER: Final = {"real/easy": "0.932", "real/medium": "0.873"}
"""Overlap in the paper, of its own frames."""

SHOWN: Final[Mapping[str, tuple[str, str, tuple[str, ...], int | None]]] = {
    "sessions": ("calibration", "Made sessions of ten frames", (), None),
    "recordings solved together": ("calibration", "Recordings not used before, every fourth frame", (), None),
    "halves": (
        *("calibration", "Halves of a session"),
        ("0617", "synth, 16 frames, seeds 710", "another program, hard 621"),
        None,
    ),
    "followed": ("recordings", "By the window of images", (), None),
    "clocks": ("clocks_and_cables", "Made recordings of two seconds", (), None),
    "cables": ("clocks_and_cables", "Cables of a real arm", (), None),
    "both eyes": ("rig_and_arms", "Five sessions of both eyes", (), 4),
    "tools that cross": ("rig_and_arms", "Tools that cross", ("with the other tool", "alone"), None),
    "worlds": ("frames", "Worlds of every kind", (), None),
    "falsified": ("frames", "Falsified frames", (), None),
    "mistakes": ("frames", "Mistakes of users", (), None),
    "segmentation": ("segmentation", "The paper's real images", (), None),
    "times": ("speed", "Times", (), None),
    "live": ("recordings", "Live", (), None),
}
"""Tables of the page on accuracy, by the names of their places: file, title of the section, beginnings of the rows that
are shown (none: all) and number of columns that are (None: all)."""

_HEAD: Final = ("frames", "right mode", "jaw tips, median mm", "shaft axis, median deg")
_MADE: Final = ("clean", "easy", "medium", "hard")


def written() -> dict[Path, str]:
    """Return the texts of the pages with their tables written anew.

    Raises
    ------
    InputError
        A place is not marked, or a section or row is not there.
    """
    figures = json.loads((ROOT / "data" / "figures.json").read_text(encoding="utf-8"))["frames"]
    readme = _replaced(README.read_text(encoding="utf-8"), "figures of frames", f"{_readme_table(figures)}\n")
    page = ACCURACY.read_text(encoding="utf-8")
    for name, chosen in figures.items():
        page = _replaced(page, f"figures of {name}", f"{_accuracy_table(chosen)}\n")
    for name, shown in SHOWN.items():
        page = _replaced(page, f"measured {name}", f"{_section(*shown)} ")
    claims = _replaced(EXPERIMENTS.read_text(encoding="utf-8"), "experiments", f"\n{_claims()}\n\n")
    return {README: readme, ACCURACY: page, EXPERIMENTS: claims}


def write_pages(*, check: bool = False) -> int:
    """Write the pages; with ``check`` only return 1 if one is not as its files say."""
    off = {path: text for path, text in written().items() if path.read_text(encoding="utf-8") != text}
    for path, text in off.items():
        print(f"{path.relative_to(ROOT)}: {'not as the figures say' if check else 'written'}")
        if not check:
            write_text(path, text)
    return int(check and bool(off))


def _replaced(page: str, name: str, text: str) -> str:
    """Replace what is between the marked lines of a place."""
    begin, end = f"<!-- {name}: made by scripts/measure.py -->\n", f"<!-- end of {name} -->"
    before, found, rest = page.partition(begin)
    _, ended, after = rest.partition(end)
    if not (found and ended):
        raise InputError(f"expected the lines {begin.strip()} and {end}, got none")
    return f"{before}{begin}{text}{end}{after}"


def _section(file: str, title: str, beginnings: tuple[str, ...], columns: int | None) -> str:
    """Return the rows of a section that are shown, and the line that says how they were measured."""
    path = MEASUREMENTS / f"{file}.md"
    found = [part for part in path.read_text(encoding="utf-8").split("\n## ") if part.splitlines()[0] == title]
    if len(found) != 1:
        raise InputError(f"{path}: expected one section {title!r}, got {len(found)}")
    lines = found[0].splitlines()
    measured = next(line for line in lines if line.startswith("Measured "))
    cells = [[*map(str.strip, line.strip("| ").split("|"))] for line in lines if line.startswith("|")]
    head, _, *rows = ([*row, *[""] * (len(cells[0]) - len(row))] for row in cells)
    missing = [name for name in beginnings if not any(row[0].startswith(name) for row in rows)]
    if missing:
        raise InputError(f"{path}: {title}: expected rows that begin with {missing}, got none")
    chosen = [row for row in rows if not beginnings or row[0].startswith(beginnings)]
    shown = [head, ["---"] * len(head), *chosen]
    table = "\n".join("".join(f"| {cell} " if cell else "| " for cell in row[:columns]) + "|" for row in shown)
    return f"{table}\n\n{measured}"


def _number(value: float) -> str:
    """Format an error: two decimals below 1, else one."""
    return f"{value:.2f}" if round(value, 2) < 1 else f"{value:.1f}"


def _cells(row: Mapping[str, Any]) -> list[str]:
    """Return the cells of a row: right mode, tips, shaft, worst joint, overlap, ok."""
    errors = [_number(row[name]) if name in row else "" for name in ("tip_mm", "axis_deg", "joint_deg")]
    right = f"{row['right_mode']} of {row['frames']}" if "right_mode" in row else ""
    return [right, *errors, f"{row['iou']:.3f}", f"{row['ok']} of {row['frames']}"]


def _origin(chosen: Mapping[str, Any]) -> str:
    """Return when, of which commit and where a set was measured."""
    return f"Measured {chosen['date']}, commit {chosen['commit']}, on {chosen['machine']}"


def _readme_table(figures: Mapping[str, Any]) -> str:
    """Return the README's table: the bundled instrument, then the scanned one in each cell; the real frames."""
    bundled, scanned = (figures[name] for name in ("bundled", "scanned"))
    rows: list[Sequence[str]] = []
    for level in _MADE:
        both = [f"{a}, {b}" for a, b in zip(*(_cells(own["rows"][level]) for own in (bundled, scanned)), strict=True)]
        rows.append([level, *both[:3], *both[4:]])
    for name, paper in PAPER.items():
        one = _cells(scanned["rows"][name])
        rows.append([name.replace("/", ", "), "", "", "", f"{one[4]} (the paper: {paper})", one[5]])
    first, second = _origin(bundled), _origin(scanned)
    said = first if first == second else f"First: {first.lower()}. Second, and real: {second.lower()}"
    return f"{markdown((*_HEAD, 'overlap (IoU)', 'marked ok'), rows)}\n\n{said}."


def _accuracy_table(chosen: Mapping[str, Any]) -> str:
    """Return the table of a set for the page on accuracy."""
    rows = []
    for level, row in chosen["rows"].items():
        one = _cells(row)
        one[4] += f" (the paper: {PAPER[level]})" if level in PAPER else ""
        rows.append([level.replace("/", ", "), *one])
    head = (*_HEAD, "worst joint, median deg", "overlap (IoU)", "marked ok")
    return f"{markdown(head, rows)}\n\n{_origin(chosen)}."


def _claims() -> str:
    """Return the claims of experiments, whether they hold, and where and when each ran; InputError if one was quick."""
    rows, ran, machines = [], [], dict[str, None]()
    for name in ("table1", "figure4", "table2"):
        path = ROOT / "data" / "experiments" / f"{name}.json"
        document = json.loads(path.read_text(encoding="utf-8"))
        title, of = document["title"].split(":")[0], document["ran"]
        if of["quick"]:
            raise InputError(f"{path}: expected a full run, got a quick one")
        for number, claim in enumerate(document["claims"]):
            link = "" if number else f"[{title}](../experiments/{name}.md)"
            rows.append((link, claim["text"], "yes" if claim["holds"] else "**no**", claim["figures"]))
        ran.append(f"{title}: {of['date']}, commit {of['commit']}, {of['minutes']:g} min")
        machines[of["machine"]] = None
    table = markdown(("experiment", "what it should show", "holds", "figures"), rows)
    return f"{table}\n\nRun on {' and '.join(machines)}. {'; '.join(ran)}."
