"""Each command that reads a session, with a link in each place of it: nothing outside of the session is opened.

A link leads to a file or folder beside the session, directly or by a second link, to nothing, or to itself. What is
beside the session has an old time of access, which the system renews as soon as anything reads it: native
libraries, too.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from fuzzing.runs import LINES, QUICK, Report, Runner

_SESSION, _BESIDE = "session", "beside"
COMMANDS: Final = (
    *(LINES[name] for name in ("batch", "calibrate", "track", "segment")),
    ("import", _SESSION, "--out", "made"),
    ("pnp", _SESSION),
    ("golden", "record", _SESSION, *QUICK),
    ("inspect", _SESSION),
)
_OWN: Final = {
    "ignore/0000.png": None,
    "session.toml": '[camera]\nfile = "camera.yaml"\n[[tool]]\narm = "PSM1"\n',
    "keypoints.csv": "frame,tip_1_u,tip_1_v,tip_2_u,tip_2_v\n0000,80,60,90,60\n",
    "boxes.csv": "frame,x0,y0,x1,y1\n0000,20,20,140,110\n",
    "images.csv": "frame,time\n0000,1.0\n0001,1.1\n0002,1.2\n",
    "results/frames/0000.json": "{}",
}
"""Files that are added to the session, by their content; None is that of the first mask."""
PLACES: Final = (
    *("masks", "images", "ignore", "results", "results/frames"),
    *("masks/0000.png", "images/0000.jpg", "camera.yaml", "joints.csv", "golden.json"),
    *("session.toml", "keypoints.csv", "boxes.csv", "images.csv"),
)
KINDS: Final = ("outside", "by a second link", "to nothing", "to itself")
_OLD: Final = 10**9  # ns


def fuzz_links(
    material: Path,
    place: Path,
    run: Runner,
    places: Sequence[str] = PLACES,
    commands: Sequence[Sequence[str]] = COMMANDS,
) -> Report:
    """Run each command with each kind of link in each place; ``place`` is a folder for copies of the material."""
    report = Report("links")
    for name in places:
        for kind in KINDS:
            for command in commands:
                shutil.rmtree(place, ignore_errors=True)
                shutil.copytree(material, place)
                for path, text in _OWN.items():
                    own = place / _SESSION / path
                    own.parent.mkdir(parents=True, exist_ok=True)
                    own.write_bytes(
                        (place / _SESSION / "masks/0000.png").read_bytes() if text is None else text.encode()
                    )
                _put_link(place, name, kind)
                with contextlib.chdir(place):
                    _attempt(report, name, kind, list(command), run)
    shutil.rmtree(place, ignore_errors=True)
    return report


def _put_link(place: Path, name: str, kind: str) -> None:
    """Put a link in the place of a file or folder of the session, whose content is beside the session then."""
    linked, beside = place / _SESSION / name, place / _BESIDE / Path(name).name
    beside.parent.mkdir()
    linked.rename(beside)
    if kind == "to nothing":
        beside = beside.with_name("nothing")
    elif kind == "to itself":
        beside = linked
    elif kind == "by a second link":
        (linked.parent / "second").symlink_to(beside, target_is_directory=beside.is_dir())
        beside = linked.parent / "second"
    linked.symlink_to(beside, target_is_directory=beside.is_dir())
    for path in (place / _BESIDE).rglob("*"):
        os.utime(path, ns=(_OLD, path.stat().st_mtime_ns))


def _attempt(report: Report, name: str, kind: str, command: list[str], run: Runner) -> None:
    before = _state()
    ended = run(command)
    changed = sorted(str(path) for path in before.items() ^ _state().items())
    report.tries[command[0]] += 1
    report.refused += ended.code == 2
    what = f"  {' '.join(command[:2])} with {name} {kind}: exit code {ended.code}: "
    if changed:
        report.violations.append(what + f"opened, changed or removed: {', '.join(changed)[:300]}")
    if "internal error" in ended.err or "Traceback" in ended.err or ended.code not in (0, 1, 2, 3):
        report.violations.append(what + ended.err.strip()[-300:])


def _state() -> dict[str, tuple[int, int]]:
    """Return the times of access and change of the files beside the session; those of folders of change alone."""
    found = {}
    for path in Path(_BESIDE).rglob("*"):
        status = path.stat()
        found[str(path)] = (0 if path.is_dir() else status.st_atime_ns, status.st_mtime_ns)
    return found
