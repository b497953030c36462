"""Each command that writes, told to write to each kind of existing folder: no file of the user is changed or removed.

All files in the folder of the material are the user's, but for those that an earlier run of the same command wrote to
OUT. A view of the file system notes the paths that Python opens for writing, renames or removes; what OpenCV writes is
seen by the contents of the files.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from fuzzing.runs import DONE, FRAME, LINES, Report, Runner

_OUT: Final = "made"
_SYNTH: Final = ("synth", "--frames", "1", "--no-images")
COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    **{name: (*line, "--out") for name, line in LINES.items()},
    **{f"{name} --overwrite": (*LINES[name], "--overwrite", "--out") for name in ("batch", "import")},
    "synth": _SYNTH,
    "synth --overwrite": (*_SYNTH, "--overwrite"),
    "estimate": (*FRAME, "--image", "session/images/0000.jpg", "--out"),
}
"""Command lines without the folder, which is the last word."""

_NOTES: Final = "notes.txt"
_APART: Final = "elsewhere"


def _made_by(*command: str) -> Callable[[Path, Runner], None]:
    def make(out: Path, run: Runner) -> None:
        ended = run([*command, str(out)])
        if ended.code not in DONE:
            raise SystemExit(f"fuzz: the folder could not be made: {' '.join(command)}: {ended.err}")

    return make


def _calibration(out: Path, run: Runner) -> None:
    shutil.copytree("results", out, dirs_exist_ok=True)
    shutil.copy("session.json", out / "session.json")
    listed = out / "run.json"
    listed.write_text(listed.read_text().replace('"command": "batch"', '"command": "calibrate"'))


def _copy_of(name: str) -> Callable[[Path, Runner], None]:
    def make(out: Path, run: Runner) -> None:
        shutil.copytree(name, out, dirs_exist_ok=True)

    return make


KINDS: Final[dict[str, Callable[[Path, Runner], None]]] = {
    "empty": lambda out, run: None,
    "session": _copy_of("session"),
    "images": _copy_of("session/images"),
    "batch": _copy_of("results"),
    "calibration": _calibration,
    "tracks": _made_by(*COMMANDS["track"]),
    "segment": _made_by(*COMMANDS["segment"]),
    "import": _made_by(*COMMANDS["import"]),
}
"""How each kind of existing folder is made, in the folder of the material."""

_MAKERS: Final = {"batch": "batch", "calibration": "calibrate", "tracks": "track", "segment": "segment"}


def fuzz_folders(
    material: Path, place: Path, run: Runner, commands: tuple[str, ...] = tuple(COMMANDS), *, all_three: bool = True
) -> Report:
    """Tell each command to write to each kind of folder, as it is, with a file of the user in it, and with a link.

    ``place`` is a folder for a copy of the material; it is the working folder meanwhile. Unless ``all_three`` are
    combined, a third of the tries is made, in which each command meets each kind of folder and each of what is in it.
    """
    report = Report("folders")
    for number, kind in enumerate(KINDS):
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(material, place)
        shutil.rmtree(place / _OUT, ignore_errors=True)
        (place / _OUT).mkdir()
        with contextlib.chdir(place):
            KINDS[kind](Path(_OUT), run)
        tries = [
            (more, name)
            for i, more in enumerate(("nothing", "notes", "link"))
            for k, name in enumerate(commands)
            if all_three or (number + i + k) % 3 == 0
        ]
        for more, name in tries:
            fresh = place.with_name(f"{place.name} again")
            shutil.rmtree(fresh, ignore_errors=True)
            _copy(place, fresh)
            if more == "notes":
                (fresh / _OUT / _NOTES).write_text("mine")
            elif more == "link":
                _put_link(fresh)
            with contextlib.chdir(fresh):
                _attempt(report, name, kind, run)
            shutil.rmtree(fresh, ignore_errors=True)
    return report


def _put_link(place: Path) -> None:
    """Put a link in the place of a folder in OUT, to that folder beside OUT, in which is a file of the user."""
    inner = sorted(path for path in (place / _OUT).iterdir() if path.is_dir())
    linked = inner[0] if inner else place / _OUT / "frames"
    linked.mkdir(exist_ok=True)
    (place / _APART).mkdir()
    shutil.move(linked, place / _APART / "apart")
    (place / _APART / "apart" / _NOTES).write_text("mine")
    os.symlink(place / _APART / "apart", linked)


def _copy(place: Path, fresh: Path) -> None:
    """Copy OUT, and link the other files, which no command may change; if one does, its own try says so."""
    shutil.copytree(
        place, fresh, copy_function=os.link, ignore=lambda folder, _: [_OUT] if Path(folder) == place else []
    )
    shutil.copytree(place / _OUT, fresh / _OUT)


def _attempt(report: Report, name: str, kind: str, run: Runner) -> None:
    """Run a command in the working folder and add what it violated to the report."""
    own = {_MAKERS.get(kind, kind), f"{_MAKERS.get(kind, kind)} --overwrite"}
    before = _contents()
    with _written_paths() as touched:
        ended = run([*COMMANDS[name], _OUT])
    after = _contents()
    lost = [path for path, data in before.items() if after.get(path) != data]
    if name in own:  # what it wrote itself may be replaced
        lost = [path for path in lost if Path(path).parts[0] != _OUT or path.endswith(_NOTES)]
    here = Path.cwd()
    outside = sorted({path for path in touched if _is_foreign(Path(path), here)})
    report.tries[name] += 1
    report.refused += ended.code == 2
    what = f"  {name} into a folder of kind {kind}: exit code {ended.code}: "
    if lost:
        report.violations.append(what + f"changed or removed: {', '.join(sorted(lost))[:300]}")
    if outside:
        report.violations.append(what + f"written outside OUT: {', '.join(outside)[:300]}")
    if ended.code == 1 and "internal error" in ended.err:
        report.violations.append(what + ended.err.strip()[-300:])


def _contents() -> dict[str, bytes]:
    """Return the files below the working folder by path."""
    return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def _is_foreign(path: Path, here: Path) -> bool:
    """Return whether a path is in the folder of the material, but neither OUT nor a temporary folder beside it."""
    if not path.is_relative_to(here) or path == here:
        return False
    return not path.relative_to(here).parts[0].startswith((_OUT, ".", "run.json"))


_noted: list[set[str]] = []
_hooked: list[bool] = []


@contextlib.contextmanager
def _written_paths() -> Iterator[set[str]]:
    """Yield a set to which the absolute paths are added that are opened for writing, renamed or removed meanwhile."""
    if not _hooked:
        sys.addaudithook(_note)  # there is no way to remove it
        _hooked.append(True)
    _noted.append(set())
    try:
        yield _noted[-1]
    finally:
        _noted.pop()


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    if not _noted:
        return
    paths: tuple[tuple[Any, Any], ...] = ()  # each with the handle of the folder that it is relative to, -1 for none
    if event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_TRUNC):
        paths = ((arguments[0], -1),)  # the handle is unknown: these are run.json, or have temporary names
    elif event in ("os.remove", "os.rmdir", "os.mkdir", "shutil.rmtree"):
        paths = ((arguments[0], arguments[-1]),)
    elif event == "os.truncate":
        paths = ((arguments[0], -1),)
    elif event in ("os.rename", "os.link"):
        paths = tuple(zip(arguments[:2], arguments[2:], strict=True))
    elif event == "os.symlink":
        paths = ((arguments[1], arguments[2]),)
    for path, handle in paths:
        if isinstance(path, str | bytes | Path):
            above = os.readlink(f"/proc/self/fd/{handle}") if isinstance(handle, int) and handle >= 0 else ""
            _noted[-1].add(os.path.abspath(os.path.join(above, os.fsdecode(path))))
