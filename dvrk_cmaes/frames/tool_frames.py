"""The frames of a session as each of its tools sees them: its own masks and readings, and what hides it."""

from __future__ import annotations

from dataclasses import replace

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles, OtherTool
from dvrk_cmaes.frames.own_files import check_own
from dvrk_cmaes.frames.session_folder import Session, image_files
from dvrk_cmaes.frames.session_toml import SessionEntries


def frames_of_tool(session: Session, entries: SessionEntries, arm: str) -> Session:
    """Return a session with the masks of one tool only; the other tools' pixels do not count.

    ``session`` was read with the tool's own folder of masks, if it has one. Another tool may be before or behind this
    one, so its pixels have no information on it, neither as instrument nor as background.

    Raises
    ------
    InputError
        There is no such arm, the folder of masks of another tool has none, or one is a link that leaves the session.
    """
    tool, others = entries.tool(arm), [other for other in entries.tools if other.arm != arm]
    masks = {
        (other.arm, view): image_files(other.masks / view)
        for other in others
        if other.masks is not None
        for view in session.view_names
    }
    check_own(session.folder, (path for of_view in masks.values() for path in of_view.values()))
    for other in others:
        if other.masks is not None and not any(masks[other.arm, view] for view in session.view_names):
            raise InputError(f"{other.masks}: expected masks (PNG or JPEG) of {other.arm}, got none")

    def of_view(files: FrameFiles, view: str) -> FrameFiles:
        """Return the files of one view of a frame for the tool, with those of its further views."""
        hiding = []
        for other in others:
            if other.masks is None and files.mask is not None:
                hiding.append(OtherTool(files.mask, other.label, other.arm, other.pick))
            elif other.masks is not None and files.name in masks[other.arm, view]:
                hiding.append(OtherTool(masks[other.arm, view][files.name], None, other.arm))
        more = {name: of_view(each, name) for name, each in files.others.items()}
        return replace(files, label=tool.label, pick=tool.pick, other_tools=tuple(hiding), others=more)

    return replace(session, frames=tuple(of_view(files, session.view_names[0]) for files in session.frames))
