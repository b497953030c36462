"""Measure how accurate and how honest estimates are, on session folders whose truth is known. Run by hand.

    python scripts/accuracy.py errors SESSION...       errors, spreads, share doubted
    python scripts/accuracy.py calibration SESSION...  do the 90 % intervals hold the truth
    python scripts/accuracy.py lies SESSION...         are falsified frames doubted
    python scripts/accuracy.py bound SESSION...        errors and spreads against the smallest possible (Cramer-Rao)
    python scripts/accuracy.py sessions SESSION...     each solved together: errors of its base, its 95 % intervals
    python scripts/accuracy.py session-lies SESSION... each falsified as a whole: is that named

A session folder holds camera.yaml, joints.csv, masks and golden.json, the truth; of a session without it, errors and
bound say what needs none. data/demo is one; `dvrk-cmaes synth` makes more. A session's name without its digits is its
level (clean, easy, ...). Calibration wants at least 200 frames. --keep DIR writes results there and takes those there
already: several commands share them, and what is kept is from the program that wrote it. What each part of the
method is worth: scripts/experiments/ablation.py.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from accuracy_bound import bound_report
from accuracy_calibration import calibration_report
from accuracy_cases import Case, Run, read_cases, run_cases
from accuracy_errors import error_report, frame_errors, frame_rows
from accuracy_lies import lie_report, load_others, make_lies
from accuracy_session import Outcome, Trial, honest_trials, read_bases, run_trials, session_report
from accuracy_session_lies import false_cases, false_trials
from accuracy_session_lies import lie_report as session_lie_report
from accuracy_spread_bound import mask_report
from accuracy_tables import show, write_features

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.silhouette.prepare import prepare

Report = Mapping[str, Sequence[Mapping[str, Any]]]

OTHERS: Final = Path(__file__).resolve().parents[2] / "shared" / "instruments" / "dvrk_model" / "urdf"
QUICK_FRAMES: Final = 2


def main() -> int:
    arguments = _parser().parse_args()
    if arguments.quick:
        arguments.frames = QUICK_FRAMES
        arguments.sessions = arguments.sessions[:1]
    try:
        report = COMMANDS[arguments.command](arguments)
    except InputError as error:
        print(f"accuracy.py: {error}", file=sys.stderr)
        return 2
    if arguments.json:
        print(json.dumps(report, indent=1))
    else:
        for title, rows in report.items():
            show(title, rows)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=sorted(COMMANDS), help="what to measure")
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="session folder with golden.json")
    parser.add_argument("--instrument", default="lnd", metavar="NAME|URDF", help="what is in the frames")
    parser.add_argument("--config", type=Path, metavar="TOML", help="settings of the estimates")
    parser.add_argument("--frames", type=int, metavar="N", help="at most so many of each session, evenly spread")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes, one thread each")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write results there, and use those that are there")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="errors, lies: write the features of every estimate")
    parser.add_argument("--table", action="store_true", help="errors: one row a frame, too")
    parser.add_argument("--cases", type=int, default=40, metavar="N", help="lies: of each kind")
    parser.add_argument("--others", type=Path, default=OTHERS, metavar="DIR", help="lies: URDFs of other instruments")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="lies: of the random numbers")
    parser.add_argument("--quick", action="store_true", help="two frames of one session: does it run at all")
    return parser


def _config(arguments: argparse.Namespace) -> EstimateConfig:
    default = EstimateConfig()
    return default if arguments.config is None else read_config(arguments.config, default)


def _honest(arguments: argparse.Namespace, *, truth: bool = True) -> list[Case]:
    return read_cases(arguments.sessions, instrument=arguments.instrument, frames=arguments.frames, truth=truth)


def _run(arguments: argparse.Namespace, cases: Sequence[Case], label: str = "frames") -> list[Run]:
    return run_cases(
        cases,
        instrument=arguments.instrument,
        config=_config(arguments),
        workers=arguments.workers,
        keep=arguments.keep,
        label=label,
    )


def _write_csv(arguments: argparse.Namespace, runs: Sequence[Run]) -> None:
    if arguments.csv is not None:
        instrument = prepare(arguments.instrument).instrument
        write_features(arguments.csv, runs, [frame_errors(instrument, run) for run in runs])


def errors(arguments: argparse.Namespace) -> Report:
    runs = _run(arguments, _honest(arguments, truth=False))
    instrument = prepare(arguments.instrument).instrument
    _write_csv(arguments, runs)
    report = error_report(instrument, runs)
    if arguments.table:
        report["frames"] = list(frame_rows(instrument, runs))
    return report


def calibration(arguments: argparse.Namespace) -> Report:
    runs = _run(arguments, _honest(arguments))
    instrument = prepare(arguments.instrument).instrument
    return {"90 % intervals that hold the truth": calibration_report(instrument, runs)}


def lies(arguments: argparse.Namespace) -> Report:
    honest = _honest(arguments)
    others = load_others(arguments.others)
    if not others:
        print(f"{arguments.others}: no such folder; no lies of other instruments", file=sys.stderr)
    false = make_lies(honest, others, QUICK_FRAMES // 2 if arguments.quick else arguments.cases, arguments.seed)
    runs = _run(arguments, [*honest, *false], label="frames and lies")
    _write_csv(arguments, runs)
    return {"share doubted": lie_report(runs)}


def bound(arguments: argparse.Namespace) -> Report:
    runs = _run(arguments, _honest(arguments, truth=False))
    body, config = prepare(arguments.instrument), _config(arguments)
    return {**bound_report(body, runs, config), **mask_report(body, runs, config)}


def _solve(arguments: argparse.Namespace, trials: Sequence[Trial]) -> list[Outcome]:
    return run_trials(trials, instrument=arguments.instrument, config=_config(arguments), workers=arguments.workers)


def sessions(arguments: argparse.Namespace) -> Report:
    bases = read_bases(arguments.sessions)
    outcomes = _solve(arguments, honest_trials(_run(arguments, _honest(arguments)), bases))
    return session_report(prepare(arguments.instrument).instrument, outcomes)


def session_lies(arguments: argparse.Namespace) -> Report:
    bases, cases = read_bases(arguments.sessions), _honest(arguments)
    grouped: dict[str, list[Case]] = {}
    for case in cases:
        grouped.setdefault(case.session, []).append(case)
    runs = _run(arguments, [*cases, *false_cases(grouped)], label="frames and lies")
    honest = honest_trials(runs[: len(cases)], bases)
    return session_lie_report(_solve(arguments, false_trials(honest, runs[len(cases) :])))


COMMANDS: Final = {
    "errors": errors,
    "calibration": calibration,
    "lies": lies,
    "bound": bound,
    "sessions": sessions,
    "session-lies": session_lies,
}


if __name__ == "__main__":
    sys.exit(main())
