"""Damage inputs of every kind and run the commands that read them: each must succeed, or refuse in one line.

    python scripts/fuzz.py --tries 400              # in this process, with the estimates replaced by a stored result
    python scripts/fuzz.py --tries 40 --processes   # the whole program in a process of its own for each try
    python scripts/fuzz.py --family mask --only 17  # one try again
    python scripts/fuzz.py tracker --steps 100000   # a tracker with damaged masks, images, readings and times
    python scripts/fuzz.py live --tries 300        # the loop of live with faults of times and messages
    python scripts/fuzz.py kills --tries 200        # commands that are killed, or whose disk is full
    python scripts/fuzz.py folders                  # commands that are told to write to folders of all kinds
    python scripts/fuzz.py links                    # links in sessions, which lead out of them
    python scripts/fuzz.py cases                    # files as other laboratories have them
    python scripts/fuzz.py earlier --tries 100      # commands that are killed while they replace an earlier result
    python scripts/fuzz.py together --tries 200     # two commands at once in one folder

Prints the numbers of tries, refusals and violations by family; the exit code is 1 if there is a violation. Those are: a
traceback or an internal error; anything but one line on stderr, or anything on stdout or written, with exit code 2; a
wrong exit code; a file accepted that cannot be read at all; more than 30 s of processor time; and for processes more
than 1.5 GB.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import os
import random
import shutil
import stat
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from measure.fuzz.damage import ODD_WORDS, damage_place, damaged_bytes, damaged_document, damaged_text
from measure.fuzz.earlier import EarlierReport, fuzz_earlier
from measure.fuzz.families import FAMILIES, OPTIONS, Family, write_material
from measure.fuzz.folders import FolderReport, fuzz_folders
from measure.fuzz.kills import FAULTS, KillReport, fuzz_kills
from measure.fuzz.lab_files import LabReport, fuzz_cases
from measure.fuzz.links import fuzz_links
from measure.fuzz.live_faults import LiveReport, fuzz_live
from measure.fuzz.runs import SLOW, Outcome, Runner, in_a_process, in_this_process, stubbed
from measure.fuzz.together import TogetherReport, fuzz_together
from measure.fuzz.tracker import TrackerReport, fuzz_tracker

LARGE = 1500.0  # MB
_LONGEST_LINE = 1000
_PLACES = 0.1  # share of the tries in which something else than a file is in its place
Status = tuple[int, int]
"""Size of a file, and its time of change, ns; zeros for a folder."""

_JSON = ("inspect", "--json")  # which reports on stdout as well


def main() -> int:
    """Run the tries and print the report; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [family.name for family in FAMILIES]
    parser.add_argument(
        "what",
        nargs="?",
        choices=("inputs", "tracker", "live", "kills", "folders", "links", "earlier", "together", "cases"),
        default="inputs",
    )
    parser.add_argument("--tries", type=int, default=200, metavar="N", help="tries a family (default: %(default)s)")
    parser.add_argument("--between", type=int, default=60, metavar="N", help="of live, good images after each fault")
    parser.add_argument("--steps", type=int, default=100_000, metavar="N", help="of tracker (default: %(default)s)")
    parser.add_argument("--family", choices=names, action="append", help="only this family; may be repeated")
    parser.add_argument("--only", type=int, metavar="K", help="only the try with this number")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the damage (default: %(default)s)")
    parser.add_argument("--processes", action="store_true", help="run the whole program in a process for each try")
    parser.add_argument("--fault", choices=FAULTS, action="append", help="of kills, only this one; may be repeated")
    arguments = parser.parse_args()
    if arguments.what != "inputs":
        report: TrackerReport | LiveReport | KillReport | FolderReport | EarlierReport | TogetherReport | LabReport
        if arguments.what == "tracker":
            report = fuzz_tracker(arguments.steps, arguments.seed)
        elif arguments.what == "live":
            report = fuzz_live(arguments.tries, arguments.between)
        elif arguments.what == "cases":
            report = fuzz_cases(in_this_process)
        elif arguments.what in ("folders", "links", "earlier", "together"):
            report = _over_earlier_files(arguments.what, arguments.tries, arguments.seed)
        else:
            report = fuzz_kills(arguments.tries, arguments.seed, faults=arguments.fault or FAULTS)
        print(report)
        return 1 if report.violations else 0
    numbers = range(arguments.tries) if arguments.only is None else [arguments.only]
    chosen = [family for family in FAMILIES if arguments.family is None or family.name in arguments.family]
    violations = tries = 0
    with tempfile.TemporaryDirectory() as place:
        material = Path(place, "material")
        material.mkdir()
        write_material(material)
        with stubbed(material) if not arguments.processes else contextlib.nullcontext():
            run = in_a_process if arguments.processes else in_this_process
            for family in chosen:
                found = Report(family.name)
                for number in numbers:
                    found.add(number, *attempt(family, number, arguments.seed, material, Path(place, "try"), run))
                print(found, flush=True)
                violations, tries = violations + len(found.violations), tries + found.tries
    print(f"{tries} tries, {violations} violations")
    return 1 if violations else 0


def _over_earlier_files(what: str, tries: int, seed: int) -> FolderReport | EarlierReport | TogetherReport:
    """Run commands on folders that have files: in this process, or, where two run or one is killed, in processes."""
    with tempfile.TemporaryDirectory() as place:
        material = Path(place, "material")
        material.mkdir()
        write_material(material)
        if what in ("earlier", "together"):
            fuzz = fuzz_earlier if what == "earlier" else fuzz_together
            return fuzz(tries, seed, material, Path(place, "try"))
        with stubbed(material):
            return (fuzz_links if what == "links" else fuzz_folders)(material, Path(place, "try"), in_this_process)


class Report:
    """Counts of a family's tries, and its violations."""

    def __init__(self, name: str) -> None:
        self.name, self.tries, self.refused = name, 0, 0
        self.violations: list[str] = []

    def add(self, number: int, command: list[str], outcome: Outcome, violation: str | None) -> None:
        """Count a try."""
        self.tries += 1
        self.refused += outcome.code == 2
        if violation is not None:
            self.violations.append(f"  try {number}: {' '.join(command)[:150]}: {violation}")

    def __str__(self) -> str:
        head = f"{self.name}: {self.tries} tries, {self.refused} refused, {len(self.violations)} violations"
        return "\n".join([head, *self.violations])


def attempt(
    family: Family, number: int, seed: int, material: Path, place: Path, run: Runner, *, inspected: bool = False
) -> tuple[list[str], Outcome, str | None]:
    """Damage a copy of the material, run a command on it, and say how the outcome violates what is promised, if so.

    ``place`` is the folder of the copy; one of an earlier try is restored. With ``inspected``, the command is `inspect`
    where that reads the family's file, which takes a fraction of the time of others.
    """
    chance = random.Random(f"{seed} {family.name} {number}")
    copied = restore(material, place)
    quick = [command for command in family.commands if inspected and command[0] == "inspect"]
    command = list(chance.choice(quick or family.commands))
    unreadable = damage(family, place, command, chance)
    before = {name: status for name, status in copied.items() if name != family.file} | _status(place, family.file)
    with contextlib.chdir(place):
        outcome = run(command)
    changed = contents(place) != before
    return command, outcome, violation_of(outcome, command, changed=changed, unreadable=unreadable and family.refuses)


def damage(family: Family, place: Path, command: list[str], chance: random.Random) -> bool:
    """Damage the family's file, or add an option to the command; returns whether the file cannot be read at all."""
    if family.kind == "options":
        command += [chance.choice(OPTIONS), chance.choice(ODD_WORDS)]
        return False
    path = place / family.file
    if chance.random() < _PLACES:
        return damage_place(path, chance) != "missing"
    data = path.read_bytes()
    match family.kind:
        case "document":
            path.write_bytes(damaged_document(data.decode(), chance))
        case "text":
            path.write_bytes(damaged_text(data.decode(), chance))
        case _:
            path.write_bytes(damaged_bytes(data, chance))
    return False


def violation_of(outcome: Outcome, command: Sequence[str], *, changed: bool, unreadable: bool) -> str | None:
    """Say how an outcome violates what is promised; None if it does not."""
    lines = outcome.err.splitlines()
    if "Traceback" in outcome.err + outcome.out or "internal error" in outcome.err:
        return f"exit code {outcome.code}: {outcome.err.strip()[-300:]}"
    if outcome.seconds > SLOW or outcome.megabytes > LARGE:
        return f"{outcome.seconds:.0f} s, {outcome.megabytes:.0f} MB"
    incomplete = "--merge" in command and "still to be done" in outcome.err
    off = "golden" in command and outcome.code == 1 and not outcome.err  # poses beyond their tolerance
    if outcome.code not in (0, 2, 3) and not (incomplete or off):
        return f"exit code {outcome.code}: {outcome.err.strip()[-300:]}"
    if outcome.code != 2:
        return "accepted, though it cannot be read" if unreadable else None
    if len(lines) != 1 or not lines[0].startswith("dvrk-cmaes: ") or len(lines[0]) > _LONGEST_LINE:
        return f"exit code 2 with {len(lines)} lines on stderr: {outcome.err[:300]!r}"
    if outcome.out and not all(word in command for word in _JSON):
        return f"exit code 2 with output: {outcome.out[:100]!r}"
    return "exit code 2, but files were written" if changed else None


def restore(material: Path, place: Path) -> dict[str, Status]:
    """Make a folder a copy of the material again, by the files that differ; returns its contents.

    The material must not have changed since it was restored for the first time.
    """
    place.mkdir(exist_ok=True)
    wanted, there = _contents_once(material), contents(place)
    for name in [name for name, status in there.items() if wanted.get(name) != status]:
        path = place / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)  # gone with its folder
    for name in sorted(name for name, status in wanted.items() if there.get(name) != status):
        source, path = material / name, place / name
        if source.is_dir():
            path.mkdir()
        else:
            shutil.copy2(source, path, follow_symlinks=False)
    return wanted


def contents(folder: Path) -> dict[str, Status]:
    """Return size and time of change of everything in a folder, by its path."""
    found: dict[str, Status] = {}
    left = [""]
    while left:
        below = left.pop()
        with os.scandir(folder / below) as entries:
            for entry in entries:
                name, status = below + entry.name, entry.stat(follow_symlinks=False)
                if entry.is_dir(follow_symlinks=False):
                    found[name] = (0, 0)
                    left.append(f"{name}/")
                else:
                    found[name] = (status.st_size, status.st_mtime_ns)
    return found


@functools.lru_cache(maxsize=2)
def _contents_once(folder: Path) -> dict[str, Status]:
    return contents(folder)


def _status(folder: Path, name: str) -> dict[str, Status]:
    """Return what `contents` says of a path in a folder; nothing if there is none."""
    path = folder / name
    if not name or not os.path.lexists(path):
        return {}
    status = path.lstat()
    return {name: (0, 0) if stat.S_ISDIR(status.st_mode) else (status.st_size, status.st_mtime_ns)}


if __name__ == "__main__":
    sys.exit(main())
