"""The tools of a session that a command works on, and what its session.toml says of their instruments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.cli.options import TWIN, CalibrationOptions, ReadingOptions, joint_files, load_tool
from dvrk_cmaes.cli.terminal import Line, answer, note, show, table_lines, warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import counted, listed, no_folder

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.cli.options import SessionOptions
    from dvrk_cmaes.frames.session_toml import ToolEntry
    from dvrk_cmaes.geometry import Float64
    from dvrk_cmaes.results.result import Result
    from dvrk_cmaes.runs.frame import ArmInSession


def read_arms(
    folder: Path,
    given: SessionOptions,
    calibrated: CalibrationOptions = CalibrationOptions(),
    *,
    single: bool = False,
    joints: Sequence[Path] | None = (),
    reading: ReadingOptions = ReadingOptions(),
    labelled: bool = False,
    ahead: bool = True,
    **more: Any,
) -> dict[str, ArmInSession]:
    """Describe the arms of a session, or those asked for, by folder of results: what each sees, and how it is solved.

    That folder is the arm's name, or "" if the session has one tool: its results are in the folder itself. What
    session.toml says counts where the command line says nothing.

    ``single``: whether the command works on one arm. ``joints`` and ``more`` are as in `read_session`.
    ``labelled``: whether masks of labels may be in the folder labels, as they may where session.toml names a label.
    With ``ahead``, texts and borders over the images are looked for.

    Raises
    ------
    InputError
        An arm that the session does not name, or several for a command that works on one; settings or a calibration
        that are not valid; as `read_session`.
    """
    from dvrk_cmaes.frames.session_toml import SESSION_FILE, ToolEntry, read_session_toml

    entries, only, camera = read_session_toml(folder), given.only, given.camera
    if only and not entries.tools:
        raise InputError(f"--only: expected a session.toml that names arms in {folder}, got none")
    chosen = [entries.tool(arm) for arm in only] or entries.tools or (ToolEntry(""),)
    if single and len(chosen) > 1:
        raise InputError(f"{folder / SESSION_FILE}: tool: expected one, got {', '.join(tool.arm for tool in chosen)}")
    labels = folder / "labels"
    asked: dict[str, Any] = {
        "camera": camera.camera,
        "rectified": camera.rectified,
        "side": camera.side,
        **more,
        "masks": labels if labelled and labels.is_dir() and not (folder / "masks").exists() else None,
    }
    calibrated.check_for([tool.arm for tool in chosen])
    found = {}
    for tool in chosen:
        arm = tool.arm or None
        asked["joints"] = None if joints is None else joint_files(joints, arm)
        asked["read_as"] = reading.read_as(arm)
        read = _read_arm(folder, given, calibrated, tool, asked, ahead=ahead)
        found[tool.arm if len(entries.tools) > 1 else ""] = read
    return found


def _read_arm(
    folder: Path,
    given: SessionOptions,
    calibrated: CalibrationOptions,
    tool: ToolEntry,
    asked: dict[str, Any],
    *,
    ahead: bool,
) -> ArmInSession:
    """Load the instrument of an arm, and read the session with its own masks and readings, and its calibration."""
    from dvrk_cmaes.estimation.one_tool import FrameMethod
    from dvrk_cmaes.frames.overlays import with_overlaid
    from dvrk_cmaes.frames.session_folder import NO_READINGS, read_session
    from dvrk_cmaes.runs.frame import ArmInSession

    settings, named, own = given.settings(), given.instrument.instrument, tool.instrument
    if named is not None:
        if own is not None and named != own and Path(named).resolve() != Path(own).resolve():
            warn(f"{tool.arm}: session.toml names {own}, but --instrument {named} is used")
        tool = replace(tool, instrument=named, packages={}, root_link=None, tool=None)
    body = load_tool(replace(tool, packages={**tool.packages, **given.instrument.described}))
    session = read_session(folder, arm=tool.arm or None, known=body.instrument.joint_names, **asked)
    session = with_overlaid(session) if ahead else session
    if asked["joints"] is not None and NO_READINGS in session.notes:
        note(f"{folder}: no joints.csv, as with --joints none: {TWIN}")
    for text in session.warnings:
        warn(f"{folder}: {text}")
    known = calibrated.read(body, given.instrument.arm, tool.arm)
    method = FrameMethod(given.instrument.arm or tool.kinematics or "classic", settings, known)
    return ArmInSession(session, body, method)


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


def answer_by_arm(documents: Mapping[str, Any], lines: Mapping[str, Iterable[Line]], *, json: bool) -> None:
    """Print the documents of all arms as JSON, or else their lines, those of each of several below its name."""
    titled = ([*([Line(name, "bold")] if name else []), *own] for name, own in lines.items())
    answer(documents.get("", documents), (line for own in titled for line in own), json=json)


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
    first = places[0]
    for place, following in zip(places, (*places[1:], None), strict=True):
        if following != place + 1:
            yield names[first] if first == place else f"{names[first]} to {names[place]}"
            first = following or 0


def doubt_exchanged(results: Mapping[str, Mapping[str, Result]]) -> bool:
    """Warn where arms seem to have each other's masks or readings, given their results by frame; returns whether."""
    from dvrk_cmaes.runs.agreement import exchanged_arms

    texts = exchanged_arms(results)
    for text in texts:
        warn(text)
    return bool(texts)


def write_bases(
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
