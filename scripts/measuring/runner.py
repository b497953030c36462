"""Runs of the program's commands in this process on session folders, and what they wrote; kept results are reused."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import shutil
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from dvrk_cmaes.cli import main
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import write_json

Command = Literal["estimate", "calibrate", "track", "pnp"]

LINES: Final[Mapping[Command, tuple[str, ...]]] = {
    "estimate": ("batch", "--workers", "1"),
    "calibrate": ("calibrate", "--workers", "1"),
    "track": ("track", "--no-video", "--no-page"),
    "pnp": ("pnp",),
}
"""The command line that solves a folder: each frame by itself, all together, or as a recording that is followed."""


@dataclass(frozen=True)
class Failure:
    """A command that ended with an error: its exit code, or "crash", its last line on stderr, and what was run."""

    frame: str
    code: int | str
    error: str
    run: str


@dataclass(frozen=True)
class Ran:
    """A folder that was solved: where the results are, what failed, seconds by the clock and of processor time."""

    out: Path
    failures: tuple[Failure, ...]
    seconds: float
    processor: float

    def of_arm(self, arm: str | None) -> Path:
        """Return the folder of an arm's results."""
        return self.out / arm if arm and (self.out / arm).is_dir() else self.out

    def documents(self, arm: str | None = None) -> dict[str, dict[str, Any]]:
        """Return the results of an arm by frame: of frames/FRAME.json, or rows of tracks.jsonl."""
        own = self.of_arm(arm)
        tracks = own / "tracks.jsonl"
        if tracks.exists():
            rows = [json.loads(line) for line in tracks.read_text(encoding="utf-8").splitlines()]
            return {row["frame"]: row for row in rows}
        files = sorted((own / "frames").glob("*.json"))
        return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files}

    def document(self, name: str, arm: str | None = None) -> dict[str, Any] | None:
        """Return a document such as session.json; None if it was not written."""
        path = self.of_arm(arm) / name
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def run(arguments: Sequence[str], frame: str = "") -> tuple[str, Failure | None]:
    """Run a command line in this process; return its stdout, and the failure if it is one (exit code not 0 or 3)."""
    out, err = io.StringIO(), io.StringIO()
    code: int | str
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except Exception:  # a defect: counted, so that other folders are still solved
            traceback.print_exc()
            code = "crash"
    if code in (0, 3):
        return out.getvalue(), None
    lines = err.getvalue().strip().splitlines() or ["(nothing on stderr)"]
    return out.getvalue(), Failure(frame, code, lines[-1], shlex.join(["dvrk-cmaes", *arguments]))


def solved(folder: Path, command: Command, out: Path, options: Sequence[str] = ()) -> Ran:
    """Solve a folder by a command with further options; results that are later than the folder's files are reused."""
    name, *usual = LINES[command]
    arguments = [name, str(folder), "--out", str(out), *usual, *options]
    kept = out.with_name(f"{out.name}.json")
    newest = max(path.stat().st_mtime for path in (folder, *folder.iterdir()))
    if kept.exists() and kept.stat().st_mtime >= newest:
        known = json.loads(kept.read_text(encoding="utf-8"))
        if known["arguments"] == arguments:
            failures = tuple(Failure(**each) for each in known["failures"])
            return Ran(out, failures, known["seconds"], known["processor"])
    shutil.rmtree(out, ignore_errors=True)
    began, before = time.perf_counter(), sum(os.times()[:4])
    _, failure = run(arguments)
    seconds, processor = time.perf_counter() - began, sum(os.times()[:4]) - before
    failures = () if failure is None else (failure,)
    record = {"arguments": arguments, "failures": [asdict(each) for each in failures]}
    write_json(kept, {**record, "seconds": seconds, "processor": processor})
    return Ran(out, failures, seconds, processor)


def goldens(folder: Path) -> dict[str | None, dict[str, Any]]:
    """Return the truth of a session folder by arm, of a session of one arm by None; empty without truth."""
    paths: dict[str | None, Path] = {
        path.stem.removeprefix("golden_"): path for path in sorted(folder.glob("golden_*.json"))
    }
    if not paths and (folder / "golden.json").exists():
        paths[None] = folder / "golden.json"
    return {arm: json.loads(path.read_text(encoding="utf-8")) for arm, path in paths.items()}


def sessions_in(folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the session folders among folders, or in them.

    Raises
    ------
    InputError
        There is none.
    """
    for folder in folders:
        found = [path for path in (folder, *sorted(folder.glob("*"))) if (path / "joints.csv").exists()]
        found = found or [path for path in (folder, *sorted(folder.glob("*"))) if [*path.glob("golden*.json")]]
        if not found:
            raise InputError(f"{folder}: expected a session folder, or a folder of some, got none")
        yield from found[:1] if found[0] == folder else found
