"""The tools of a session that a command works on, and what its session.toml says of their instruments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.cli.options import TWIN, CalibrationOptions, ReadingOptions, joint_files
from dvrk_cmaes.cli.terminal import DOUBTFUL, FAILED, Line, answer, note, show, table_lines, warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import counted, listed, no_folder

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.cli.options import SessionOptions
    from dvrk_cmaes.geometry import Float64
    from dvrk_cmaes.results.result import Result
    from dvrk_cmaes.runs.frame import ArmInSession


def open_session(
    folder: Path,
    given: SessionOptions,
    calibrated: CalibrationOptions = CalibrationOptions(),
    *,
    single: bool = False,
    joints: Sequence[Path] = (),
    reading: ReadingOptions = ReadingOptions(),
    ahead: bool = True,
    together: bool = False,
    **overrides: Any,
) -> dict[str, ArmInSession]:
    """Describe the arms of a session, or those asked for, by folder of results: what each sees, and how it is solved.

    That folder is the arm's name, or "" if the session has one tool: its results are in the folder itself. What
    session.toml says counts where the command line says nothing. Each arm's instrument is loaded, and the session read
    with its own masks and readings, and its calibration.

    ``single``: whether the command works on one arm. ``joints`` are as of `joint_files`, ``overrides`` as of
    `read_session`. With ``ahead``, texts and borders over the images are looked for. ``together``: whether frames are
    solved together, which needs readings.

    Raises
    ------
    InputError
        An arm that the session does not name, or several for a command that works on one; settings or a calibration
        that are not valid; as `read_session`.
    """
    from dvrk_cmaes.estimation.one_tool import FrameMethod
    from dvrk_cmaes.frames.overlays import with_overlaid
    from dvrk_cmaes.frames.session_folder import NO_READINGS, read_session
    from dvrk_cmaes.frames.session_toml import SESSION_FILE, ToolEntry, read_session_toml
    from dvrk_cmaes.instrument.arm import OUTER_JOINTS
    from dvrk_cmaes.runs.frame import ArmInSession

    entries, only, own = read_session_toml(folder), given.only, given.instrument
    if only and not entries.tools:
        raise InputError(f"--only: expected a session.toml that names arms in {folder}, got none")
    chosen = [entries.tool(arm) for arm in only] or entries.tools or (ToolEntry(""),)
    if single and len(chosen) > 1:
        raise InputError(f"{folder / SESSION_FILE}: tool: expected one, got {', '.join(tool.arm for tool in chosen)}")
    calibrated.check_for([tool.arm for tool in chosen])
    found = {}
    for tool in chosen:
        arm, settings = tool.arm or None, given.settings()
        body, files, read_as = own.load_for(tool), joint_files(joints, arm), reading.read_as(arm)
        asked: dict[str, Any] = {**vars(given.camera), **overrides, "joints": files, "read_as": read_as}
        session = read_session(folder, arm=arm, known=body.instrument.joint_names, **asked)
        session = with_overlaid(session) if ahead else session
        if files is not None and NO_READINGS in session.notes:
            if together:
                outer = ", ".join(OUTER_JOINTS)
                raise InputError(f"{folder}: expected readings of {outer} (joints.csv, or --joints FILE), got none")
            note(f"{folder}: no joints.csv, as with --joints none: {TWIN}")
        for text in session.warnings:
            warn(f"{folder}: {text}")
        known = calibrated.read(body, own.arm, tool.arm)
        method = FrameMethod(own.arm or tool.kinematics or "classic", settings, known)
        found[tool.arm if len(entries.tools) > 1 else ""] = ArmInSession(session, body, method)
    return found


_MOST_REASONS = 8
_MOST_LISTED = 10


def pictures_at(path: Path) -> tuple[Path, str | None]:
    """Return the folder that a path names, and the pattern of its frames' names where it is a photo or a glob."""
    picture = path.is_file() and path.suffix.lower() in (".png", ".jpg", ".jpeg")
    if path.is_dir() or not (picture or any(mark in path.name for mark in "*?[")):
        return path, None
    folder = path.parent
    return folder.parent if folder.name in ("images", "masks") else folder, path.stem


@contextmanager
def output_folder(out: Path | None, inside: Path, name: str, command: str, *, wait: float = 0.0) -> Iterator[Path]:
    """Yield the folder to write to, which is opened: OUT, or a folder of a name inside another one by default.

    That folder inside another one may be no link; errors and ``wait`` are as of `dvrk_cmaes.io.output.output`.
    """
    from dvrk_cmaes.io.output import check_no_link, output

    if out is None and not inside.is_dir():
        raise InputError(f"{inside}: {no_folder(inside)}; expected a session with camera.yaml, joints.csv and masks")
    path = inside / name if out is None else out
    if out is None:
        check_no_link(path)
    with output(path, command, wait=wait):
        yield path


@dataclass(frozen=True, eq=False)
class ArmReport:
    """What a command says of an arm: a document or lines, warnings, and the exit code of this arm alone.

    Arms are compared with each other by their ``results``, by frame, and by their ``calibration``.
    """

    document: Mapping[str, Any]
    lines: Iterable[Line]
    warnings: Iterable[str]
    code: int
    results: Mapping[str, Result] = field(default_factory=dict)
    calibration: SessionCalibration | None = None


def report_arms(
    arms: Mapping[str, ArmReport], out: Path, setup: Mapping[str, Float64], *, json: bool, followed: bool = False
) -> int:
    """Print the documents of all arms as JSON, or else their lines; compare the arms, and return the exit code.

    Arms are doubtful that seem to have each other's masks or readings, or whose bases are not where the set-up joints
    have them, ``setup``. Where all are calibrated, these are written. ``followed``: frames are in the order of time.
    """
    from dvrk_cmaes.runs.agreement import exchanged_arms

    documents = {name: own.document for name, own in arms.items()}
    titled = ([*([Line(name, "bold")] if name else []), *own.lines] for name, own in arms.items())
    answer(documents.get("", documents), (line for own in titled for line in own), json=json)
    for name, own in arms.items():
        for text in dict.fromkeys(own.warnings):
            warn(text, name)
    exchanged = exchanged_arms({name: own.results for name, own in arms.items()}, followed=followed)
    for text in exchanged:
        warn(text)
    known = {name: own.calibration for name, own in arms.items() if own.calibration is not None}
    agree = not 1 < len(known) == len(arms) or _write_bases(known, setup, out, quiet=json)
    codes = {own.code for own in arms.values()}
    return FAILED if codes == {FAILED} else DOUBTFUL if exchanged or not agree or codes != {0} else 0


def found_lines(calibration: SessionCalibration) -> Iterator[Line]:
    """Yield the lines of a calibration: base, offsets, frames left out, lag, and leave-one-out errors."""
    from dvrk_cmaes.report.tables import calibration_lines, calibration_tables

    for table in calibration_tables(calibration):
        yield from table_lines(table, _MOST_LISTED)
    yield from map(Line, calibration_lines(calibration))


def reason_lines(reasons: Mapping[str, Sequence[str]]) -> Iterator[Line]:
    """Yield a line for each kind of reason why frames are not ok, most frequent first, with these frames.

    The reason of a single frame is there in full.
    """
    from dvrk_cmaes.report.template import frames_by_reason, reason_kind

    names, kinds = list(reasons), frames_by_reason(reasons.values())
    for kind, places in kinds[:_MOST_REASONS]:
        of_first = reasons[names[places[0]]]
        text = kind if len(places) > 1 else next(text for text in of_first if reason_kind(text) == kind)
        yield Line(f"  {text}: {counted(len(places), 'frame')} ({listed(_stretches(names, places))})", "yellow")
    if len(kinds) > _MOST_REASONS:
        yield Line(f"  ... and {len(kinds) - _MOST_REASONS} more, in the results")
    if kinds:
        yield Line("  what to do about reasons: dvrk-cmaes help problems")


def _stretches(names: Sequence[str], places: Sequence[int]) -> Iterator[str]:
    """Yield the frames at increasing places, those that follow each other as ``FIRST to LAST``."""
    for _, run in groupby(enumerate(places), lambda counted: counted[1] - counted[0]):
        in_row = [names[place] for _, place in run]
        yield in_row[0] if len(in_row) == 1 else f"{in_row[0]} to {in_row[-1]}"


def _write_bases(
    calibrations: Mapping[str, SessionCalibration], setup: Mapping[str, Float64], out: Path, *, quiet: bool
) -> bool:
    """Write arms.json, where the arms' bases are relative to the first one's, and print it unless ``quiet``.

    Returns whether they are where the set-up joints have them, whose poses of the arms ``setup`` are by name.
    """
    from dvrk_cmaes.calibration.together import against_setup, arms_document, relative_bases
    from dvrk_cmaes.io.json_file import write_json
    from dvrk_cmaes.results.folder import ARMS

    bases, reference = relative_bases(calibrations), next(iter(calibrations))
    compared = against_setup(bases, reference, setup)
    write_json(out / ARMS, arms_document(calibrations, bases, compared))
    if not quiet:
        show(Line(f"base of {arm} from that of {reference}: {base.describe()}") for arm, base in bases.items())
    wrong = {arm: own for arm, own in compared.items() if not own.agrees}
    for arm, own in wrong.items():
        warn(own.describe(arm, reference))
    return not wrong
