"""Draw the tasks of the benchmark, solve them by the methods that are compared, and score submissions.

    python scripts/run_benchmark.py run FOLDER                draws, solves, scores; --methods ours, pnp, ...; continues
    python scripts/run_benchmark.py draw FOLDER               draws what is given to methods, in FOLDER/given
    python scripts/run_benchmark.py score FOLDER CSV...       scores submissions against what was drawn in FOLDER
    python scripts/run_benchmark.py pictures FOLDER           plots of the scores that were written to FOLDER, and the
                                                              table of the page data/reference/benchmark.md
    python scripts/run_benchmark.py keep FILE                 draws seeds into a new file, and prints their SHA-256
    python scripts/run_benchmark.py m3t FOLDER                writes the files of M3T, for each recording drawn, about
                                                              the start of --start CSV
    python scripts/run_benchmark.py m3t-read FOLDER           reads M3T's poses in FOLDER, as the submission m3t.csv
    python scripts/run_benchmark.py anchors [RESULTS]         prints the real recordings: what to put where, and the
                                                              commands that measure them without a truth; or compares
                                                              results with the shafts that are seen by both eyes

The page data/reference/benchmark.md explains the tasks and the format of submissions.
"""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from benchmark.anchors import anchors, shaft_report
from benchmark.m3t import read_poses, write_tracker
from benchmark.methods import METHODS, OURS, solved
from benchmark.pictures import write_page
from benchmark.score import Scores, ranked, reliability, score_row, score_submission
from benchmark.submission import Key, Row, read_submission, write_submission
from benchmark.tasks import FRAMES, KEPT, SEED, TASKS, Given, TaskName, digest, given_task, set_name, table
from measure.processes import in_processes
from measure.tables import Report, print_report

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.io.atomic import write_json, write_text

SCORES: Final = "scores.json"
"""File of a folder's scores."""


def main() -> int:
    """Run a command and print its report; return the exit code."""
    options = _parser().parse_args()
    return print_report("run_benchmark.py", lambda: COMMANDS[options.command](options), as_json=options.json)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=sorted(COMMANDS), help="what to do")
    parser.add_argument("paths", nargs="*", type=Path, metavar="PATH", help="the folder, and submissions")
    parser.add_argument("--worlds", type=int, default=20, metavar="N", help="the first N worlds (default: %(default)s)")
    parser.add_argument("--numbers", metavar="N,...", help="numbers of worlds of the table, instead of the first ones")
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="seed of the worlds (default: %(default)s)")
    parser.add_argument("--tasks", default=",".join(TASKS), metavar="T,...", help="tasks (default: %(default)s)")
    parser.add_argument(
        "--methods",
        default="ours",
        metavar="M,...",
        help=f"methods of run: some of {', '.join(METHODS)}; ours: {', '.join(OURS)} (default: %(default)s)",
    )
    parser.add_argument("--session-frames", type=int, default=FRAMES["session"], metavar="N", help="frames of sessions")
    parser.add_argument(
        "--recording-frames", type=int, default=FRAMES["recording"], metavar="N", help="frames of recordings"
    )
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default: %(default)s)")
    parser.add_argument("--start", type=Path, metavar="CSV", help="for m3t: submission that has the first poses")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def _run(options: argparse.Namespace) -> Report:
    """Draw, solve and score; the submission of each method is written to the folder."""
    folder = _folder(options)
    names = [name for each in options.methods.split(",") for name in (OURS if each == "ours" else [each])]
    _known("--methods", names, METHODS)
    chosen = [(method, task) for method in names for task in METHODS[method][0] if task in _tasks(options)]
    jobs = [(folder, options, world, chosen) for world in _numbers(options)]
    rows: dict[str, list[Row]] = {method: [] for method in names}

    def take(_: int, found: Sequence[tuple[str, Row]]) -> None:
        for method, row in found:
            rows[method].append(row)

    in_processes(_one_world, jobs, options.workers, "worlds", take)
    for method, own in rows.items():
        write_submission(folder / f"{method}.csv", sorted(own, key=lambda row: row.key))
    return _scored(options, [folder / f"{method}.csv" for method in names])


def _one_world(
    folder: Path, options: argparse.Namespace, number: int, chosen: Sequence[tuple[str, TaskName]]
) -> list[tuple[str, Row]]:
    """Solve a world by methods, each in a task; return the rows with the name of the method."""
    out = folder / "solved" / set_name(options.seed) / f"{number:03d}"
    found: list[tuple[str, Row]] = []
    for method, task in chosen:
        given = _given(folder, options, number, task)
        found += [] if given is None else [(method, row) for row in solved(method, given, out).values()]
    return found


def _given(folder: Path, options: argparse.Namespace, number: int, task: TaskName) -> Given | None:
    """Return a task of a world; None, after a line on stderr, if no motion is found."""
    counts: Any = {"session": options.session_frames, "recording": options.recording_frames}
    try:
        return given_task(folder, task, table()[number], options.seed, counts)
    except InputError:
        raise
    except DvrkCmaesError as error:
        print(f"run_benchmark.py: {error}", file=sys.stderr)
        return None


def _all_given(options: argparse.Namespace) -> list[Given]:
    """Return all tasks of the worlds."""
    folder = _folder(options)
    found = [_given(folder, options, number, task) for number in _numbers(options) for task in _tasks(options)]
    return [given for given in found if given is not None]


def _draw(options: argparse.Namespace) -> Report:
    """Draw what is given to methods."""
    return {
        "given": [
            {"task": given.task, "world": given.world.number, "folder": str(given.given.path)}
            for given in _all_given(options)
        ]
    }


def _score(options: argparse.Namespace) -> Report:
    """Score submissions."""
    if len(options.paths) < 2:
        raise InputError(f"score: expected a folder and submissions (CSV), got {len(options.paths)} path(s)")
    return _scored(options, options.paths[1:])


def _scored(options: argparse.Namespace, submissions: Sequence[Path]) -> Report:
    """Score submissions, write the scores to the folder, and return the table."""
    givens, rows, curves, worlds = _all_given(options), [], {}, []
    for path in submissions:
        try:
            by_task = score_submission(givens, read_submission(path))
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        for task, scores in by_task.items():
            rows.append(score_row(path.stem, task, scores))
            curves[f"{task}: {path.stem}"] = reliability(scores)
            worlds += [_of_world(path.stem, each) for each in scores]
    report: dict[str, Any] = {"table": ranked(rows), "by world": worlds}
    given = {"seed": options.seed, "worlds": _numbers(options)}
    write_json(_folder(options) / SCORES, {**report, "reliability": curves, "given": given})
    return report


def _of_world(method: str, scores: Scores) -> dict[str, Any]:
    """Return the row of a world."""
    row = score_row(method, scores.given.task, [scores])
    return {"world": scores.given.world.number, **{name: value for name, value in row.items() if name != "worlds"}}


def _keep(options: argparse.Namespace) -> Report:
    """Draw as many seeds as are kept into a new file, and print their SHA-256."""
    (path,) = options.paths or [None]
    if path is None or path.exists():
        raise InputError(f"keep: expected the name of a new file, got {path}")
    seeds = [str(secrets.randbits(128)) for _ in KEPT]
    write_text(path, "".join(f"{seed}\n" for seed in seeds))
    return {"SHA-256": [{"seed": number, "sha256": digest(seed)} for number, seed in enumerate(seeds, 1)]}


def _pictures(options: argparse.Namespace) -> Report:
    """Write the plots, and the table of the page."""
    return {"written": [{"file": str(path)} for path in write_page(_folder(options) / SCORES)]}


def _m3t(options: argparse.Namespace) -> Report:
    """Write the files of M3T for the recordings of the task images."""
    if options.start is None:
        raise InputError("m3t: expected --start with a submission that has the first poses, got none")
    start, options.tasks = read_submission(options.start), "images"
    written = []
    for given in _all_given(options):
        key: Key = ("images", given.world.number, given.frames[0])
        if key not in start or start[key].pose is None:
            print(f"run_benchmark.py: {options.start}: no pose of world {key[1]}, frame {key[2]}", file=sys.stderr)
            continue
        out = _folder(options) / "m3t" / f"{given.world.number:03d}"
        written.append({"world": given.world.number, "file": str(write_tracker(out, given, start[key]))})
    return {"written": written}


def _m3t_read(options: argparse.Namespace) -> Report:
    """Read the poses of M3T, and write the submission."""
    options.tasks, folder = "images", _folder(options)
    rows = []
    for given in _all_given(options):
        path = folder / "m3t" / f"{given.world.number:03d}" / "poses.csv"
        rows += read_poses(path, given) if path.exists() else []
    write_submission(folder / "m3t.csv", rows)
    return {"written": [{"file": str(folder / "m3t.csv"), "rows": len(rows)}]}


def _folder(options: argparse.Namespace) -> Path:
    """Return the folder."""
    if not options.paths or options.paths[0].is_file():
        raise InputError(f"{options.command}: expected a folder, got {options.paths[0] if options.paths else 'none'}")
    return Path(options.paths[0])


def _tasks(options: argparse.Namespace) -> list[TaskName]:
    """Return the tasks that are asked for."""
    names: list[TaskName] = options.tasks.split(",")
    _known("--tasks", names, TASKS)
    return names


def _numbers(options: argparse.Namespace) -> list[int]:
    """Return the numbers of the worlds."""
    every = [*table()]
    if options.numbers is None:
        return every[: options.worlds]
    _known("--numbers", options.numbers.split(","), {str(number): None for number in every})
    return [int(number) for number in options.numbers.split(",")]


def _known(where: str, names: Sequence[str], known: Mapping[Any, Any]) -> None:
    """Raise an InputError for a name that is not known."""
    for name in names:
        if name not in known:
            raise InputError(f"{where}: expected some of {', '.join(known)}, got {name!r}")


COMMANDS: Final[Mapping[str, Callable[[argparse.Namespace], Report]]] = {
    "run": _run,
    "draw": _draw,
    "score": _score,
    "pictures": _pictures,
    "keep": _keep,
    "m3t": _m3t,
    "m3t-read": _m3t_read,
    "anchors": lambda options: shaft_report(_folder(options)) if options.paths else anchors(),
}

if __name__ == "__main__":
    sys.exit(main())
