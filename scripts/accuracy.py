"""Measure the accuracy of estimates, and of their standard deviations and doubts, on sessions with known truth.

    python scripts/accuracy.py errors SESSION...       errors, scatter over a session, share of doubtful results
    python scripts/accuracy.py calibration SESSION...  share of 90 % intervals that contain the truth
    python scripts/accuracy.py trust SESSION...        expected errors, probabilities of the mode and statuses
    python scripts/accuracy.py tip-probability SESSION...  stated probabilities of the tips against the truth, and
                                                       the constants that fit them best
    python scripts/accuracy.py lies SESSION...         share of falsified frames that are doubtful
    python scripts/accuracy.py bound SESSION...        errors and scatter compared with the Cramer-Rao bound
    python scripts/accuracy.py sessions SESSION...     sessions solved together: errors of the base, 95 % intervals
    python scripts/accuracy.py halves SESSION...       difference of the bases of the halves of each session
    python scripts/accuracy.py session-lies SESSION... share of falsified sessions that are reported as such
    python scripts/accuracy.py lag SESSION...          error of the lag between images and readings of synthetic videos
    python scripts/accuracy.py track SESSION...        recordings followed frame by frame: errors, losses, overlaps
    python scripts/accuracy.py fleet FOLDER...         recordings, or folders of them, followed with their calibration;
                                                       with --calibrate-every N each is calibrated, too
    python scripts/accuracy.py perturbed SESSION...    real images: back from poses that are moved and turned
    python scripts/accuracy.py cables SESSION...       recordings with and without a model of the cables: joints
    python scripts/accuracy.py rig SESSION...          stereo sessions: both eyes against one, and wrong rigs
    python scripts/accuracy.py turned-rigs SESSION...  stereo sessions: rotations of the right eye that are found
    python scripts/accuracy.py disparity SESSION...    stereo images: rows of points that match, by --session, too
    python scripts/accuracy.py arms SESSION...         sessions of two arms: tools that cross against the same alone
    python scripts/accuracy.py arm-bases SESSION...    sessions of several arms: how their bases lie to each other
    python scripts/accuracy.py image-sizes SESSION...  drawn masks of 14 sizes of images: errors, tips, times
    python scripts/accuracy.py camera SESSION...       share of right and wrong camera files that are contradicted
    python scripts/accuracy.py no-camera SESSION...    focal length and tips of sessions without a camera file
    python scripts/accuracy.py worlds FOLDER           worlds of every kind (scripts/worlds), drawn into FOLDER and
                                                       solved by estimate, calibrate and track

To be run by hand. A session folder has camera.yaml, joints.csv, masks and the truth, golden.json; of a session without
golden.json, errors, bound and halves report what can be measured without truth. data/demo is such a folder, and
`dvrk-cmaes synth` writes others. The level of a session (clean, easy, ...) is its name up to the first digit. The
command calibration needs at least 200 frames for useful figures. --keep DIR writes results to a folder and reuses
those in it, also for other commands; delete the folder after a change of the program. scripts/experiments/ablation.py
measures the contribution of each part of the method.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from measure.accuracy.arms import arms_report, bases_report
from measure.accuracy.bound import bound_report
from measure.accuracy.cables import cables_report
from measure.accuracy.calibration import calibration_report
from measure.accuracy.camera import measure_camera, measure_no_camera
from measure.accuracy.disparity import disparity_report
from measure.accuracy.errors import error_report, feature_rows, frame_rows
from measure.accuracy.fleet import fleet_report
from measure.accuracy.halves import halved, halves_report
from measure.accuracy.image_sizes import image_sizes_report
from measure.accuracy.lag import find_lags, lag_report
from measure.accuracy.lies import doubt_report, falsified_cases, load_other_make, load_others
from measure.accuracy.mistakes import mistake_report, mistaken_cases
from measure.accuracy.perturbed import perturbed_report
from measure.accuracy.rig import rig_report
from measure.accuracy.rig_rotations import rotations_report
from measure.accuracy.session_lies import measure_session_lies
from measure.accuracy.sessions import original_trials, session_report, solve
from measure.accuracy.spread_bound import mask_report
from measure.accuracy.tip_probability import tip_probability_report
from measure.accuracy.track import track_report
from measure.accuracy.trust import trust_report
from measure.accuracy.worlds import KINDS, worlds_report
from measure.cases import Measurement, Run
from measure.places import SHARED
from measure.tables import Report, add_output_options, print_report, write_csv
from worlds.table import worlds

from dvrk_cmaes.calibration.document import read_calibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.toml_file import read_config
from dvrk_cmaes.track.view_segmenter import KINDS as EVIDENCE

OTHERS: Final = SHARED / "instruments" / "dvrk_model" / "urdf"
QUICK_FRAMES: Final = 2


def main() -> int:
    """Run a command and print its report; return the exit code."""
    options = _parser().parse_args()
    if options.quick:
        options.frames, options.cases = QUICK_FRAMES, QUICK_FRAMES // 2
        options.sessions = options.sessions[:1]
    return print_report("accuracy.py", lambda: _report(options), as_json=options.json, kept=options.record)


def _report(options: argparse.Namespace) -> Report:
    """Return the report of a command."""
    config = EstimateConfig() if options.config is None else read_config(options.config, EstimateConfig())
    given = Measurement(options.sessions, options.instrument, config, options.frames, options.workers, options.keep)
    return COMMANDS[options.command](given, options)


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
        help="most frames of each session, evenly spaced; of track and perturbed the first (default: all); for worlds "
        "the number of each session and recording (default: 10 and 30)",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=2,
        metavar="N",
        help="number of processes, with one thread each (default: %(default)s)",
    )
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for results, which are reused")
    add_output_options(parser)
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
        "--seed",
        type=int,
        default=0,
        metavar="N",
        help="for lies and worlds: seed (default: %(default)s)",
    )
    parser.add_argument(
        "--every",
        type=int,
        default=1,
        metavar="N",
        help="for track and arm-bases: use every N-th frame (default: %(default)s)",
    )
    parser.add_argument("--session", type=Path, metavar="JSON", help="for track and disparity: session.json to use")
    parser.add_argument("--no-joints", action="store_true", help="for track and rig: estimate without readings")
    parser.add_argument(
        "--estimated", action="store_true", help="for cables: estimate the frames, instead of results about the truth"
    )
    parser.add_argument("--evidence", choices=EVIDENCE, help="for track: follow by masks (default) or images")
    parser.add_argument(
        "--calibrate-every", type=int, metavar="N", help="for fleet: calibrate every N-th frame of each recording, too"
    )
    parser.add_argument("--worlds", type=int, metavar="N", help="for worlds: the first N of the table (default: all)")
    parser.add_argument(
        "--only", action="append", choices=[*KINDS], help="for worlds: solve by this command only; may be repeated"
    )
    parser.add_argument(
        "--wrong-focal",
        type=int,
        metavar="N",
        help="for fleet: calibrate every N-th frame with a focal length that is 10 %% too short, or too long, too",
    )
    parser.add_argument("--causal", action="store_true", help="for fleet: use nothing later than each image")
    parser.add_argument("--no-ecm", action="store_true", help="for fleet: without readings of the endoscope's arm")
    parser.add_argument("--first", type=int, default=0, help="for fleet: figures of the frames from this number on")
    parser.add_argument("--quick", action="store_true", help="only two frames of one session, to test the script")
    return parser


def _write_features(given: Measurement, options: argparse.Namespace, runs: Sequence[Run]) -> None:
    """Write the features and errors of runs if --csv is given."""
    if options.csv is not None:
        write_csv(options.csv, feature_rows(given.instrument, runs))


def _errors(given: Measurement, options: argparse.Namespace) -> Report:
    """Report the errors of frames."""
    runs = given.runs(truth=False)
    _write_features(given, options, runs)
    rows = {"frames": frame_rows(given.instrument, runs)} if options.table else {}
    return error_report(given.instrument, runs) | rows


def _calibration(given: Measurement, _: argparse.Namespace) -> Report:
    """Report the share of 90 % intervals that contain the truth."""
    return {"90 % intervals that hold the truth": calibration_report(given.instrument, given.runs())}


def _trust(given: Measurement, _: argparse.Namespace) -> Report:
    """Report how well expected errors, probabilities of the mode and statuses agree with the truth."""
    return trust_report(given.instrument, given.runs())


def _tip_probability(given: Measurement, _: argparse.Namespace) -> Report:
    """Report how often the stated probability of the tips is right."""
    return tip_probability_report(given.instrument, given.runs(), given.config)


def _lies(given: Measurement, options: argparse.Namespace) -> Report:
    """Report the share of falsified frames that are doubtful, and what happens to frames with users' mistakes."""
    original, others = given.cases(), load_others(options.others)
    mistaken = mistaken_cases(original, load_other_make(options.others))
    if not others:
        print(f"{options.others}: no such folder; no lies of other instruments", file=sys.stderr)
    falsified = falsified_cases(original, others, options.cases, options.seed)
    runs = given.runs([*original, *falsified, *mistaken], "frames and lies")
    count = len(runs) - len(mistaken)
    _write_features(given, options, runs[:count])
    mistakes = mistake_report(given.body.instrument, runs[count:])
    return {"share doubted": doubt_report(runs[:count]), "mistakes": mistakes}


def _bound(given: Measurement, _: argparse.Namespace) -> Report:
    """Report errors and scatter compared with the Cramer-Rao bound."""
    runs = given.runs(truth=False)
    return bound_report(given.body, runs, given.config) | mask_report(given.body, runs, given.config)


def _sessions(given: Measurement, _: argparse.Namespace) -> Report:
    """Report the errors of sessions solved together."""
    return session_report(given.instrument, solve(given, original_trials(given.runs(given.cases(base=True)))))


def _halves(given: Measurement, _: argparse.Namespace) -> Report:
    """Report how far the bases of the halves of each session differ."""
    return halves_report(solve(given, halved(original_trials(given.runs(truth=False))), timed=True))


def _disparity(given: Measurement, options: argparse.Namespace) -> Report:
    """Report the vertical disparities of stereo images."""
    return disparity_report(given, None if options.session is None else read_calibration(options.session))


def _track(given: Measurement, options: argparse.Namespace) -> Report:
    """Report the errors of followed recordings."""
    return track_report(
        given,
        every=options.every,
        calibration=None if options.session is None else read_calibration(options.session),
        use_joints=not options.no_joints,
        evidence=options.evidence,
    )


def _worlds(given: Measurement, options: argparse.Namespace) -> Report:
    """Report what failed, and what was ok and wrong, in worlds of every kind."""
    if len(given.folders) != 1:
        raise InputError(f"worlds: expected one folder to draw into, got {len(given.folders)}")
    only = options.only or [*KINDS]
    table = worlds()[: options.worlds]
    return worlds_report(table, Path(given.folders[0]), seed=options.seed, only=only, frames=options.frames)


COMMANDS: Final[Mapping[str, Callable[[Measurement, argparse.Namespace], Report]]] = {
    "errors": _errors,
    "calibration": _calibration,
    "trust": _trust,
    "tip-probability": _tip_probability,
    "lies": _lies,
    "bound": _bound,
    "sessions": _sessions,
    "halves": _halves,
    "session-lies": lambda given, options: measure_session_lies(given, load_other_make(options.others)),
    "lag": lambda given, _: lag_report(find_lags(given)),
    "track": _track,
    "fleet": lambda given, options: fleet_report(
        given,
        causal=options.causal,
        keep=options.keep,
        every=options.calibrate_every,
        first=options.first,
        ecm=not options.no_ecm,
        wrong_focal=options.wrong_focal,
    ),
    "perturbed": lambda given, _: perturbed_report(given),
    "cables": lambda given, options: cables_report(given, estimated=options.estimated),
    "rig": lambda given, options: rig_report(given, use_joints=not options.no_joints),
    "turned-rigs": lambda given, _: rotations_report(given),
    "disparity": _disparity,
    "arms": lambda given, _: arms_report(given),
    "arm-bases": lambda given, options: bases_report(given, options.every),
    "camera": lambda given, _: measure_camera(given),
    "no-camera": lambda given, _: measure_no_camera(given),
    "worlds": _worlds,
    "image-sizes": lambda given, _: image_sizes_report(given),
}


if __name__ == "__main__":
    sys.exit(main())
