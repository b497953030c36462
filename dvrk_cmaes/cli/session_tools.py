"""The tools of a session that a command works on, and what its session.toml says of their instruments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.cli.options import DEFAULT_READING, TWIN, ReadingOptions, joint_files
from dvrk_cmaes.cli.terminal import Line, answer, note, show, warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import no_folder

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.camera.guess import CameraGuess
    from dvrk_cmaes.cli.options import CameraOptions, InstrumentOptions
    from dvrk_cmaes.frames.session_toml import SessionEntries, ToolEntry
    from dvrk_cmaes.frames.session_video import SessionVideo
    from dvrk_cmaes.geometry import Float64
    from dvrk_cmaes.instrument.arm import Arm
    from dvrk_cmaes.runs.agreement import ArmInSession
    from dvrk_cmaes.silhouette import Body


def _options_of(options: InstrumentOptions, tool: ToolEntry) -> InstrumentOptions:
    """Return the options of the instrument with what the session says of a tool; the command line wins, and warns."""
    if (
        options.instrument is not None
        and tool.instrument is not None
        and not _same(options.instrument, tool.instrument)
    ):
        warn(f"{tool.arm}: session.toml names {tool.instrument}, but --instrument {options.instrument} is used")
    return options.of_tool(tool)


def _same(instrument: str, other: str) -> bool:
    """Whether two names or paths are those of one instrument."""
    return instrument == other or Path(instrument).resolve() == Path(other).resolve()


@dataclass(frozen=True, eq=False)
class SessionTool:
    """A tool of a session that a command works on, the options of its instrument, and the entries of session.toml.

    The tool of a session that names none has the arm "".
    """

    tool: ToolEntry
    options: InstrumentOptions
    entries: SessionEntries | None

    def read(
        self,
        folder: Path,
        camera: CameraOptions,
        *,
        guess: CameraGuess | None = None,
        joints: Sequence[Path] | None = (),
        reading: ReadingOptions = DEFAULT_READING,
        video: SessionVideo | None = None,
        labelled: bool = False,
        ahead: bool = True,
    ) -> ArmInSession:
        """Load the instrument, and read the session with the masks and readings of the tool.

        What session.toml says counts where the command line says nothing. ``guess`` is the camera where there is no
        file; without it a file is needed. ``joints`` and ``video`` are as in
        `frames.session_folder`; ``reading`` says how readings are read. Masks of labels, as those of a session that is
        ``labelled``, may be in the folder labels. With ``ahead``, texts and borders over the images are looked for.
        """
        from dvrk_cmaes.frames.overlays import OVERLAID, with_overlaid
        from dvrk_cmaes.frames.session_folder import COUNTS_DIFFER, NO_READINGS, read_session
        from dvrk_cmaes.frames.session_toml import CameraEntry
        from dvrk_cmaes.frames.tool_frames import frames_of_tool
        from dvrk_cmaes.runs.agreement import ArmInSession

        body, tool, entries = self.options.load(), self.tool, self.entries
        files = None if joints is None else joint_files(joints, tool.arm or None)
        said = CameraEntry() if entries is None or camera.camera is not None else entries.camera
        labels = folder / ("labels" if labelled or tool.label is not None else "masks")
        session = read_session(
            folder,
            camera=camera.camera or said.file or said.left,
            camera_right=camera.camera_right or said.right,
            rectified=camera.rectified or said.rectified,
            side=camera.side,
            known=body.instrument.joint_names,
            joints=files if files is None else files or (() if tool.joints is None else (tool.joints,)),
            read_as=reading.read_as(tool.arm, tool.columns),
            fit=camera.fit if camera.crop or camera.stretch else said.fit,
            masks=tool.masks or (labels if labels.is_dir() and not (folder / "masks").exists() else None),
            video=video,
            guess=guess,
        )
        if entries is not None and entries.tools:
            session = frames_of_tool(session, entries, tool.arm)
        session = with_overlaid(session) if ahead else session
        if files is not None and NO_READINGS in session.notes:
            note(f"{folder}: no joints.csv, as with --joints none: {TWIN}")
        for text in session.notes:
            if text.startswith((COUNTS_DIFFER, OVERLAID)):
                warn(f"{folder}: {text}")
        return ArmInSession(session, body, self.options.kinematics)


@contextmanager
def output_folder(out: Path | None, inside: Path, name: str, command: str, *, wait: float = 0.0) -> Iterator[Path]:
    """Yield the folder to write to, which is opened: OUT, or a folder of a name inside another one by default.

    That folder inside another one may be no link; errors and ``wait`` are as of `dvrk_cmaes.io.output.output`.
    """
    from dvrk_cmaes.io.output import output

    if out is None and not inside.is_dir():
        raise InputError(f"{inside}: {no_folder(inside)}; expected a session with camera.yaml, joints.csv and masks")
    path = inside / name if out is None else out
    with output(path, command, below=inside if out is None else None, wait=wait):
        yield path


def session_tools(folder: Path, options: InstrumentOptions, only: Sequence[str] = ()) -> dict[str, SessionTool]:
    """Return the tools of a session, or those of the arms ``only``, by the subfolder that their results have.

    That is the arm's name, or "" if the session has one tool: its results are in the folder itself.

    Raises
    ------
    InputError
        An arm that the session does not name.
    """
    from dvrk_cmaes.frames.session_toml import ToolEntry, read_session_toml

    entries = read_session_toml(folder)
    named = () if entries is None else entries.tools
    if entries is None or not named:
        if only:
            raise InputError(f"--only: expected a session.toml that names arms in {folder}, got none")
        chosen: Sequence[ToolEntry] = (ToolEntry(""),)
    else:
        chosen = [entries.tool(arm) for arm in only] if only else named
    return {
        tool.arm if len(named) > 1 else "": SessionTool(tool, _options_of(options, tool), entries) for tool in chosen
    }


def single_tool(folder: Path, options: InstrumentOptions) -> SessionTool:
    """Return the tool of a session for a command that works on one.

    Raises
    ------
    InputError
        The session names several arms.
    """
    first, *others = session_tools(folder, options).values()
    if others and first.entries is not None:
        named = ", ".join(tool.arm for tool in first.entries.tools)
        raise InputError(f"{first.entries.path}: tool: expected one, got {named}")
    return first


def answer_by_arm(documents: Mapping[str, Any], lines: Mapping[str, Iterable[Line]], *, json: bool) -> None:
    """Print the documents of all arms as JSON, or else their lines, those of each of several below its name."""
    titled = ([*([Line(name, "bold")] if name else []), *own] for name, own in lines.items())
    answer(documents.get("", documents), (line for own in titled for line in own), json=json)


def read_calibration_of(
    path: Path | None, body: Body, kinematics: Arm | None, arm: str = "", *, doubtful: bool = False
) -> SessionCalibration | None:
    """Read the calibration that ``--session`` names: a session.json, or the folder that `calibrate` wrote.

    ``arm`` is one of a session with several: its own is in the folder's subfolder of that name. None without a path.
    With ``doubtful``, one that predicts frames badly is read with a warning. ``body`` is the instrument that it is used
    with, ``kinematics`` those of its arm, if they were given.

    Raises
    ------
    InputError
        There is no session.json, it is not valid, of another instrument or arm, or it predicts frames badly.
    """
    if path is None:
        return None
    from dvrk_cmaes.calibration.document import check_made_for, read_calibration
    from dvrk_cmaes.calibration.session_doubts import bad_predictions
    from dvrk_cmaes.results.folder import SESSION

    if path.is_dir():
        own = path / arm / SESSION
        path = own if own.exists() else path / SESSION
    calibration = read_calibration(path)
    check_made_for(f"{path}", calibration, body.instrument.name, kinematics)
    bad = bad_predictions(calibration)
    if bad and not doubtful:
        raise InputError(f"{path}: {bad}; --doubtful-session uses it all the same")
    for doubt in calibration.doubts:
        warn(f"{path}: {doubt}; all results are doubtful")
    return calibration


def write_bases(
    calibrations: Mapping[str, SessionCalibration], setup: Mapping[str, Float64], out: Path, *, quiet: bool
) -> bool:
    """Write arms.json, where the arms' bases are relative to the first one's, and print it unless ``quiet``.

    Returns whether they are where the set-up joints have them, whose poses of the arms ``setup`` are by name.
    """
    from dvrk_cmaes.calibration.together import against_setup, arms_document, relative_bases
    from dvrk_cmaes.io.atomic import write_json
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
