"""The frames of a session as each of its tools sees them: its own masks and readings, and what hides it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, OtherTool
from dvrk_cmaes.frames.label import Label
from dvrk_cmaes.frames.own_files import OwnFiles
from dvrk_cmaes.frames.session_folder import Session, image_files
from dvrk_cmaes.frames.session_toml import SessionEntries, ToolEntry


def frames_of_tool(session: Session, entries: SessionEntries, arm: str) -> Session:
    """Return a session with the masks of one tool only; the other tools' pixels do not count.

    ``session`` was read with the tool's own folder of masks, if it has one. Another tool may be before or behind this
    one, so its pixels have no information on it, neither as instrument nor as background.

    Raises
    ------
    InputError
        There is no such arm, the folder of masks of another tool has none, or one is a link that leaves the session.
    """
    tool, own = entries.tool(arm), OwnFiles(session.folder)
    others = [_Masks.of(other, session, own) for other in entries.tools if other.arm != arm]
    frames = tuple(_of_tool(files, session.view_names[0], tool, others) for files in session.frames)
    return replace(session, frames=frames)


@dataclass(frozen=True)
class _Masks:
    """Where the masks of another tool are: its label in the session's, or its own files by view and frame."""

    arm: str
    label: Label | None
    pick: tuple[float, float] | None
    files: Mapping[str, Mapping[str, Path]]

    @staticmethod
    def of(tool: ToolEntry, session: Session, own: OwnFiles) -> _Masks:
        if tool.masks is None:
            return _Masks(tool.arm, tool.label, tool.pick, {})
        files = {name: image_files(tool.masks / name) for name in session.view_names}
        for of_view in files.values():
            own.check_all(of_view.values())
        if not any(files.values()):
            raise InputError(f"{tool.masks}: expected masks (PNG or JPEG) of {tool.arm}, got none")
        return _Masks(tool.arm, None, tool.pick, files)

    def of_frame(self, files: FrameFiles, view: str) -> OtherTool | None:
        """Return the tool in a view of a frame; None if it has no mask there."""
        path = self.files.get(view, {}).get(files.name) if self.files else files.mask
        return None if path is None else OtherTool(path, self.label, self.arm, pick=self.pick)


def _of_tool(files: FrameFiles, view: str, tool: ToolEntry, others: Sequence[_Masks]) -> FrameFiles:
    """Return the files of one view of a frame for a tool, with those of its further views."""
    hiding = tuple(there for other in others if (there := other.of_frame(files, view)) is not None)
    more = {name: _of_tool(each, name, tool, others) for name, each in files.others.items()}
    return replace(files, label=tool.label, pick=tool.pick, other_tools=hiding, others=more)
