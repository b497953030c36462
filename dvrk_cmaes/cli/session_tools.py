"""The tools of a session that a command works on, and what its session.toml says of their instruments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvrk_cmaes.cli.terminal import warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.cli.options import CameraOptions, InstrumentOptions
    from dvrk_cmaes.frames.session_folder import Session
    from dvrk_cmaes.frames.session_toml import SessionEntries, ToolEntry
    from dvrk_cmaes.frames.session_video import SessionVideo
    from dvrk_cmaes.runs.batch import BatchSummary
    from dvrk_cmaes.runs.exchanged_tools import ArmInSession


def chosen_tools(entries: SessionEntries | None, only: Sequence[str], folder: Path) -> list[ToolEntry | None]:
    """Return the tools of a session, or those of the arms ``only``; one None for a session that names no tool.

    Raises
    ------
    InputError
        An arm that the session does not name.
    """
    if entries is None or not entries.tools:
        if only:
            raise InputError(f"--only: expected a session.toml that names arms in {folder}, got none")
        return [None]
    return [entries.tool(arm) for arm in only] if only else list(entries.tools)


def of_tool(options: InstrumentOptions, tool: ToolEntry) -> InstrumentOptions:
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
    """The one tool of a session that a command works on: its instrument's options, and the entries of session.toml."""

    options: InstrumentOptions
    entries: SessionEntries | None
    tool: ToolEntry | None

    def read(
        self,
        folder: Path,
        camera: CameraOptions,
        *,
        known: Iterable[str],
        joints: Sequence[Path] = (),
        video: SessionVideo | None = None,
    ) -> Session:
        """Read the session with the masks and readings of the tool; arguments as in `CameraOptions.read_session`."""
        entries, tool = self.entries, self.tool
        return camera.read_session(folder, known=known, joints=joints, entries=entries, tool=tool, video=video)


def single_tool(folder: Path, options: InstrumentOptions) -> SessionTool:
    """Return the tool of a session for a command that works on one.

    Raises
    ------
    InputError
        The session names several arms.
    """
    from dvrk_cmaes.frames.session_toml import read_session_toml

    entries = read_session_toml(folder)
    tools = chosen_tools(entries, (), folder)
    if len(tools) > 1 and entries is not None:
        named = ", ".join(tool.arm for tool in entries.tools)
        raise InputError(f"{entries.path}: tool: expected one, got {named}")
    tool = tools[0]
    return SessionTool(options if tool is None else of_tool(options, tool), entries, tool)


def read_calibration_of(path: Path | None, arm: str | None = None) -> SessionCalibration | None:
    """Read the calibration that ``--session`` names: a session.json, or the folder that `calibrate` wrote.

    ``arm`` is one of a session with several: its own is in the folder's subfolder of that name. None for no option.

    Raises
    ------
    InputError
        There is no session.json, or it is not valid.
    """
    from dvrk_cmaes.calibration.document import read_calibration
    from dvrk_cmaes.results.folder import SESSION

    if path is not None and path.is_dir():
        own = path / (arm or "") / SESSION
        path = own if own.exists() else path / SESSION
    return None if path is None else read_calibration(path)


def arms_in_session(
    folder: Path,
    tools: Sequence[ToolEntry | None],
    instrument: InstrumentOptions,
    camera: CameraOptions,
    entries: SessionEntries | None,
) -> dict[str, ArmInSession]:
    """Read a session as each of its arms sees it."""
    from dvrk_cmaes.runs.exchanged_tools import ArmInSession

    arms = {}
    for tool in tools:
        if tool is not None:
            options = instrument.of_tool(tool)
            body = options.load()
            known = body.instrument.joint_names
            session = camera.read_session(folder, known=known, entries=entries, tool=tool)
            arms[tool.arm] = ArmInSession(session, body, options.kinematics)
    return arms


def solve_crossing_tools(
    finished: Mapping[str, BatchSummary], scheduler: str | None, **options: Any
) -> dict[str, BatchSummary]:
    """Solve the frames of all arms again in which a tool is in front of another one, with progress on stderr."""
    from dvrk_cmaes.cli.batch_progress import progress, stopping_on_interrupt
    from dvrk_cmaes.runs.cluster import dask_executor
    from dvrk_cmaes.runs.crossing_tools import solve_crossing

    with ExitStack() as stack:
        folder = next(iter(finished.values())).setup.folder
        executor = None if scheduler is None else stack.enter_context(dask_executor(scheduler, folder))
        stop = stack.enter_context(stopping_on_interrupt())
        reporter = stack.enter_context(progress())
        return solve_crossing(finished, executor=executor, stop=stop, progress=reporter, **options)


def write_common(out: Path, arms: Mapping[str, ArmInSession]) -> Path:
    """Write the overlays and the page of all arms, whose results are in OUT/ARM; returns the path of the page."""
    from dvrk_cmaes.results.folder import read_results
    from dvrk_cmaes.runs.arms import write_arms

    folders = {arm: read_results(out / arm) for arm in arms}
    bodies = {arm: one.body for arm, one in arms.items()}
    return write_arms(out, folders, bodies, {arm: one.session for arm, one in arms.items()})
