"""Damage inputs of every kind and run the commands that read them: each must succeed, or refuse in one line.

    python scripts/fuzz.py inputs --tries 400              # in this process, estimates replaced by a stored result
    python scripts/fuzz.py inputs --tries 40 --processes   # the whole program in a process of its own for each try
    python scripts/fuzz.py inputs --family mask --only 17  # one try again
    python scripts/fuzz.py kills --tries 200               # commands that are killed, or whose disk is full
    python scripts/fuzz.py links                           # links in sessions, which lead out of them
    python scripts/fuzz.py folders                         # commands that write to folders of all kinds
    python scripts/fuzz.py pairs --tries 200               # two commands at once in one folder

Prints the numbers of tries, refusals and violations; the exit code is 1 if there is a violation. Those of inputs are: a
traceback or an internal error; anything but one line on stderr, or anything on stdout or written, with exit code 2; a
wrong exit code; a file accepted that cannot be read at all; more than 30 s of processor time; and for processes more
than 1.5 GB.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from fuzzing.damage import ODD_WORDS, damage_place, damaged_bytes, damaged_document, damaged_text
from fuzzing.families import FAMILIES, OPTIONS, Family, write_material
from fuzzing.folders import fuzz_folders
from fuzzing.kills import FAULTS, fuzz_kills
from fuzzing.links import fuzz_links
from fuzzing.pairs import fuzz_pairs
from fuzzing.runs import SLOW, Outcome, Report, Runner, in_a_process, in_this_process, stubbed

LARGE = 1500.0  # MB
_LONGEST_LINE = 1000
_PLACES = 0.1  # share of the tries in which something else than a file is in its place
_JSON = ("inspect", "--json")  # which reports on stdout as well


def main() -> int:
    """Run the tries and print the report; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [family.name for family in FAMILIES]
    parser.add_argument("what", choices=("inputs", "kills", "links", "folders", "pairs"))
    parser.add_argument("--tries", type=int, default=200, metavar="N", help="tries a family (default: %(default)s)")
    parser.add_argument("--family", choices=names, action="append", help="of inputs, only this one; may be repeated")
    parser.add_argument("--only", type=int, metavar="K", help="of inputs, only the try with this number")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the damage (default: %(default)s)")
    parser.add_argument("--processes", action="store_true", help="run the whole program in a process for each try")
    parser.add_argument("--fault", choices=FAULTS, action="append", help="of kills, only this one; may be repeated")
    options = parser.parse_args()
    violations = tries = 0
    with tempfile.TemporaryDirectory() as place:
        material, copy = Path(place, "material"), Path(place, "try")
        material.mkdir()
        write_material(material)
        for report in _reports(options, material, copy):
            print(report, flush=True)
            violations, tries = violations + len(report.violations), tries + report.tries.total()
    print(f"{tries} tries, {violations} violations")
    return 1 if violations else 0


def _reports(options: argparse.Namespace, material: Path, place: Path) -> Iterator[Report]:
    """Run what was chosen; yield a report of it, of inputs for each family."""
    if options.what == "kills":
        yield fuzz_kills(options.tries, options.seed, material, place, faults=options.fault or FAULTS)
    elif options.what == "pairs":
        yield fuzz_pairs(options.tries, options.seed, material, place)
    elif options.what == "inputs":
        run = in_a_process if options.processes else in_this_process
        with contextlib.nullcontext() if options.processes else stubbed(material):
            for family in FAMILIES:
                if options.family is None or family.name in options.family:
                    numbers = range(options.tries) if options.only is None else [options.only]
                    yield fuzz_inputs(family, numbers, options.seed, material, place, run)
    else:
        with stubbed(material):
            yield (fuzz_links if options.what == "links" else fuzz_folders)(material, place, in_this_process)


def fuzz_inputs(
    family: Family,
    numbers: Sequence[int],
    seed: int,
    material: Path,
    place: Path,
    run: Runner,
    quick: int | None = None,
) -> Report:
    """Make the tries of a family with these numbers; those from the number ``quick`` on by `inspect`, if that can."""
    report = Report(family.name)
    for number in numbers:
        inspected = quick is not None and number >= quick
        command, outcome, violation = attempt(family, number, seed, material, place, run, inspected=inspected)
        report.tries[family.name] += 1
        report.refused += outcome.code == 2
        if violation is not None:
            report.violations.append(f"  try {number}: {' '.join(command)[:150]}: {violation}")
    return report


def attempt(
    family: Family, number: int, seed: int, material: Path, place: Path, run: Runner, *, inspected: bool = False
) -> tuple[list[str], Outcome, str | None]:
    """Damage a copy of the material, run a command on it, and say how the outcome violates what is promised, if so.

    ``place`` is the folder of the copy. With ``inspected``, the command is `inspect` where that reads the family's
    file, which takes a fraction of the time of others.
    """
    chance = random.Random(f"{seed} {family.name} {number}")
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(material, place, symlinks=True)
    quick = [command for command in family.commands if inspected and command[0] == "inspect"]
    command = list(chance.choice(quick or family.commands))
    unreadable = damage(family, place, command, chance)
    before = contents(place)
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
    off = "golden" in command and outcome.code == 1 and not outcome.err  # poses beyond their tolerance
    if outcome.code not in (0, 2, 3) and not off:
        return f"exit code {outcome.code}: {outcome.err.strip()[-300:]}"
    if outcome.code != 2:
        return "accepted, though it cannot be read" if unreadable else None
    if len(lines) != 1 or not lines[0].startswith("dvrk-cmaes: ") or len(lines[0]) > _LONGEST_LINE:
        return f"exit code 2 with {len(lines)} lines on stderr: {outcome.err[:300]!r}"
    if outcome.out and not all(word in command for word in _JSON):
        return f"exit code 2 with output: {outcome.out[:100]!r}"
    return "exit code 2, but files were written" if changed else None


def contents(folder: Path) -> dict[str, tuple[int, int]]:
    """Return size and time of change of everything in a folder, by its path; zeros for a folder."""
    found = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        is_folder = stat.S_ISDIR(status.st_mode)
        found[str(path.relative_to(folder))] = (0, 0) if is_folder else (status.st_size, status.st_mtime_ns)
    return found


if __name__ == "__main__":
    sys.exit(main())
