"""Measure the accuracy of estimates, and of their standard deviations and doubts, on sessions with known truth.

    python scripts/accuracy.py errors SESSION...       errors, scatter over a session, share of doubtful results
    python scripts/accuracy.py calibration SESSION...  share of 90 % intervals that contain the truth
    python scripts/accuracy.py trust SESSION...        expected errors, probabilities of the mode and statuses
    python scripts/accuracy.py lies SESSION...         share of falsified frames that are doubtful
    python scripts/accuracy.py bound SESSION...        errors and scatter compared with the Cramer-Rao bound
    python scripts/accuracy.py sessions SESSION...     sessions solved together: errors of the base, 95 % intervals
    python scripts/accuracy.py halves SESSION...       difference of the bases of the halves of each session
    python scripts/accuracy.py session-lies SESSION... share of falsified sessions that are reported as such
    python scripts/accuracy.py lag SESSION...          error of the lag between images and readings of synthetic videos
    python scripts/accuracy.py track SESSION...        recordings followed frame by frame: errors, losses, overlaps
    python scripts/accuracy.py perturbed SESSION...    real images: back from poses that are moved and turned
    python scripts/accuracy.py cables SESSION...       recordings with and without a model of the cables: joints
    python scripts/accuracy.py rig SESSION...          stereo sessions: both eyes against one, and wrong rigs
    python scripts/accuracy.py arms SESSION...         sessions of two arms: tools that cross against the same alone
    python scripts/accuracy.py camera SESSION...       share of right and wrong camera files that are contradicted

To be run by hand. A session folder has camera.yaml, joints.csv, masks and the truth, golden.json; of a session without
golden.json, errors, bound and halves report what can be measured without truth. data/demo is such a folder, and
`dvrk-cmaes synth` writes others. The level of a session (clean, easy, ...) is its name up to the first digit. The
command calibration needs at least 200 frames for useful figures. --keep DIR writes results to a folder and reuses
those in it, also for other commands; delete the folder after a change of the program. scripts/experiments/ablation.py
measures the contribution of each part of the method.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from accuracy_arms import arms_report
from accuracy_bound import bound_report
from accuracy_cables import cables_report
from accuracy_calibration import calibration_report
from accuracy_camera import camera_report, wrong_camera_cases
from accuracy_cases import Case, Run, read_cases, run_cases
from accuracy_errors import error_report, frame_errors, frame_rows
from accuracy_halves import halved, halves_report
from accuracy_lag import find_lags, lag_report
from accuracy_lies import doubt_report, falsified_cases, load_others
from accuracy_perturbed import perturbed_report
from accuracy_rig import rig_report
from accuracy_session import Outcome, Trial, original_trials, read_bases, run_trials, session_report
from accuracy_session_lies import falsified_report, falsified_session_cases, falsified_trials
from accuracy_spread_bound import mask_report
from accuracy_tables import show, write_features
from accuracy_track import track_report
from accuracy_trust import trust_report

from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.track.sight import KINDS

Report = Mapping[str, Sequence[Mapping[str, Any]]]

OTHERS: Final = Path(__file__).resolve().parents[2] / "shared" / "instruments" / "dvrk_model" / "urdf"
QUICK_FRAMES: Final = 2


def main() -> int:
    """Run a command and print its report; return the exit code."""
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
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=sorted(COMMANDS), help="what to measure")
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="session folders with golden.json")
    parser.add_argument(
        "--instrument", default="lnd", metavar="NAME|URDF", help="instrument in the frames (default: %(default)s)"
    )
    parser.add_argument("--config", type=Path, metavar="TOML", help="settings of the estimates")
    parser.add_argument(
        "--frames",
        type=int,
        metavar="N",
        help="largest number of frames of each session, evenly spaced, or the first for track (default: all)",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=2,
        metavar="N",
        help="number of processes, with one thread each (default: %(default)s)",
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for results, which are reused")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="for errors and lies: file for the features of all estimates"
    )
    parser.add_argument("--table", action="store_true", help="for errors: print a row for each frame as well")
    parser.add_argument(
        "--cases",
        type=int,
        default=40,
        metavar="N",
        help="for lies: number of falsified frames of each kind (default: %(default)s)",
    )
    parser.add_argument(
        "--others", type=Path, default=OTHERS, metavar="DIR", help="for lies: folder of the URDFs of other instruments"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="for lies: seed of the random numbers (default: %(default)s)"
    )
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="for track: follow every N-th frame (default: %(default)s)"
    )
    parser.add_argument("--session", type=Path, metavar="JSON", help="for track: session.json to follow with")
    parser.add_argument("--no-joints", action="store_true", help="for track and rig: estimate without readings")
    parser.add_argument(
        "--estimated", action="store_true", help="for cables: estimate the frames, instead of results about the truth"
    )
    parser.add_argument("--evidence", choices=KINDS, help="for track: follow by masks (default), images or both")
    parser.add_argument("--smooth", action="store_true", help="for track: smooth")
    parser.add_argument("--quick", action="store_true", help="only two frames of one session, to test the script")
    return parser


def _config(arguments: argparse.Namespace) -> EstimateConfig:
    """Return the settings of the estimates."""
    default = EstimateConfig()
    return default if arguments.config is None else read_config(arguments.config, default)


def _original(arguments: argparse.Namespace, *, truth: bool = True) -> list[Case]:
    """Read the frames of all sessions."""
    return read_cases(arguments.sessions, instrument=arguments.instrument, frames=arguments.frames, truth=truth)


def _run(arguments: argparse.Namespace, cases: Sequence[Case], label: str = "frames") -> list[Run]:
    """Estimate cases."""
    return run_cases(
        cases,
        instrument=arguments.instrument,
        config=_config(arguments),
        workers=arguments.workers,
        keep=arguments.keep,
        label=label,
    )


def _write_csv(arguments: argparse.Namespace, runs: Sequence[Run]) -> None:
    """Write the features and errors of runs if --csv is given."""
    if arguments.csv is not None:
        instrument = prepare(arguments.instrument).instrument
        write_features(arguments.csv, runs, [frame_errors(instrument, run) for run in runs])


def errors(arguments: argparse.Namespace) -> Report:
    """Report the errors of frames."""
    runs = _run(arguments, _original(arguments, truth=False))
    instrument = prepare(arguments.instrument).instrument
    _write_csv(arguments, runs)
    report = error_report(instrument, runs)
    if arguments.table:
        report["frames"] = list(frame_rows(instrument, runs))
    return report


def calibration(arguments: argparse.Namespace) -> Report:
    """Report the share of 90 % intervals that contain the truth."""
    runs = _run(arguments, _original(arguments))
    instrument = prepare(arguments.instrument).instrument
    return {"90 % intervals that hold the truth": calibration_report(instrument, runs)}


def trust(arguments: argparse.Namespace) -> Report:
    """Report how well expected errors, probabilities of the mode and statuses agree with the truth."""
    runs = _run(arguments, _original(arguments))
    config = _config(arguments)
    return trust_report(prepare(arguments.instrument).instrument, runs, config.trust.tip_mm)


def lies(arguments: argparse.Namespace) -> Report:
    """Report the share of falsified frames that are doubtful."""
    original = _original(arguments)
    others = load_others(arguments.others)
    if not others:
        print(f"{arguments.others}: no such folder; no lies of other instruments", file=sys.stderr)
    count = QUICK_FRAMES // 2 if arguments.quick else arguments.cases
    falsified = falsified_cases(original, others, count, arguments.seed)
    runs = _run(arguments, [*original, *falsified], label="frames and lies")
    _write_csv(arguments, runs)
    return {"share doubted": doubt_report(runs)}


def bound(arguments: argparse.Namespace) -> Report:
    """Report errors and scatter compared with the Cramer-Rao bound."""
    runs = _run(arguments, _original(arguments, truth=False))
    body, config = prepare(arguments.instrument), _config(arguments)
    return {**bound_report(body, runs, config), **mask_report(body, runs, config)}


def _solve(arguments: argparse.Namespace, trials: Sequence[Trial]) -> list[Outcome]:
    """Calibrate sessions."""
    return run_trials(trials, instrument=arguments.instrument, config=_config(arguments), workers=arguments.workers)


def sessions(arguments: argparse.Namespace) -> Report:
    """Report the errors of sessions solved together."""
    bases = read_bases(arguments.sessions)
    outcomes = _solve(arguments, original_trials(_run(arguments, _original(arguments)), bases))
    return session_report(prepare(arguments.instrument).instrument, outcomes)


def halves(arguments: argparse.Namespace) -> Report:
    """Report how far the bases of the halves of each session differ."""
    cases = _original(arguments, truth=False)
    bases = dict.fromkeys((case.session for case in cases), np.eye(4))  # not compared
    return halves_report(_solve(arguments, halved(original_trials(_run(arguments, cases), bases))))


def session_lies(arguments: argparse.Namespace) -> Report:
    """Report the share of falsified sessions that are reported as such."""
    bases, cases = read_bases(arguments.sessions), _original(arguments)
    grouped: dict[str, list[Case]] = {}
    for case in cases:
        grouped.setdefault(case.session, []).append(case)
    runs = _run(arguments, [*cases, *falsified_session_cases(grouped)], label="frames and lies")
    originals = original_trials(runs[: len(cases)], bases)
    return falsified_report(_solve(arguments, falsified_trials(originals, runs[len(cases) :])))


def lag(arguments: argparse.Namespace) -> Report:
    """Report the errors of the lags found in synthetic videos."""
    runs = _run(arguments, _original(arguments))
    config = _config(arguments)
    return lag_report(find_lags(arguments.sessions, runs, instrument=arguments.instrument, config=config))


def track(arguments: argparse.Namespace) -> Report:
    """Report the errors of followed recordings."""
    return track_report(
        arguments.sessions,
        arguments.instrument,
        _config(arguments),
        frames=arguments.frames,
        every=arguments.every,
        calibration=None if arguments.session is None else read_calibration(arguments.session),
        use_joints=not arguments.no_joints,
        smooth=arguments.smooth,
        evidence=arguments.evidence,
    )


def perturbed(arguments: argparse.Namespace) -> Report:
    """Report how often images bring moved poses back."""
    return perturbed_report(arguments.sessions, arguments.instrument, _config(arguments), frames=arguments.frames)


def cables(arguments: argparse.Namespace) -> Report:
    """Report the errors of joints that the other frames of recordings predict, with and without the cables."""
    cases = _original(arguments)
    runs = _run(arguments, cases) if arguments.estimated else []
    return cables_report(arguments.sessions, arguments.instrument, _config(arguments), runs, cases)


def rig(arguments: argparse.Namespace) -> Report:
    """Report what both eyes of stereo sessions bring, and whether wrong rigs are named."""
    return rig_report(
        arguments.sessions,
        arguments.instrument,
        _config(arguments),
        frames=arguments.frames,
        use_joints=not arguments.no_joints,
    )


def arms(arguments: argparse.Namespace) -> Report:
    """Report the errors of tools that cross, and of the same tools alone."""
    return arms_report(arguments.sessions, arguments.instrument, _config(arguments), frames=arguments.frames)


def camera(arguments: argparse.Namespace) -> Report:
    """Report how many sessions contradict their camera file, right and with a focal length that is 10 % off."""
    bases, cases = read_bases(arguments.sessions), _original(arguments)
    runs = _run(arguments, [*cases, *wrong_camera_cases(cases)], label="frames with right and wrong cameras")
    trials = original_trials(runs[: len(cases)], bases) + original_trials(runs[len(cases) :], bases)
    return camera_report(_solve(arguments, trials))


COMMANDS: Final = {
    "errors": errors,
    "calibration": calibration,
    "trust": trust,
    "lies": lies,
    "bound": bound,
    "sessions": sessions,
    "halves": halves,
    "session-lies": session_lies,
    "lag": lag,
    "track": track,
    "perturbed": perturbed,
    "cables": cables,
    "rig": rig,
    "arms": arms,
    "camera": camera,
}


if __name__ == "__main__":
    sys.exit(main())
