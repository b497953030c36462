"""Reader and writer of session.toml: what is in a session folder, and which tools are in its frames.

Example::

    [camera]
    left = "left.yaml"
    right = "right.yaml"
    rectified = true

    [[tool]]
    arm = "PSM1"
    kinematics = "classic"
    instrument = "lnd"
    packages = {dvrk_model = "../dvrk_model"}
    label = 1
    joints = "joints_psm1.csv"

Paths are relative to the folder of the file. All keys but ``arm`` may be missing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from msgspec import Struct

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.frames.label import Label, parse_label
from dvrk_cmaes.frames.picture_fit import parse_crop
from dvrk_cmaes.frames.video_frames import Window
from dvrk_cmaes.io.files import check_own
from dvrk_cmaes.io.toml_file import read_toml
from dvrk_cmaes.io.typed_document import convert_document
from dvrk_cmaes.results.folder import check_frame_name

SESSION_FILE: Final = "session.toml"
_EXPECTED = {str: "text in quotes", Path: "text in quotes", dict: "a table", tuple: "a list of tables"}
Entry = TypeVar("Entry", "CameraEntry", "ToolEntry")


@dataclass(frozen=True)
class CameraEntry:
    """Camera files of a session: ``file`` of one camera or both eyes, or ``left`` and ``right``.

    ``crop`` and ``stretch``: how the pictures fit them, as of `picture_fit.fitted`.
    """

    file: Path | None = None
    left: Path | None = None
    right: Path | None = None
    rectified: bool = False
    crop: Window | None = None
    stretch: bool = False


@dataclass(frozen=True)
class ToolEntry:
    """One tool of a session: the arm that holds it, its kinematics and instrument, and its part of the files.

    ``label`` is its part of the masks, of which ``pick`` (u, v) px is on it, and ``masks`` the folder of masks where
    that is another one than the session's; ``joints`` are its readings, whose ``columns`` may be named.
    """

    arm: str
    kinematics: Literal["classic", "si"] | None = None
    instrument: str | None = None
    packages: dict[str, Path] = field(default_factory=dict)
    root_link: str | None = None
    tool: Path | None = None
    label: Label | None = None
    pick: tuple[float, float] | None = None
    masks: Path | None = None
    joints: Path | None = None
    columns: tuple[str, ...] = ()


class SessionEntries(Struct, frozen=True, rename={"tools": "tool"}):
    """The content of session.toml: the camera and the tools; neither is there without such a file."""

    camera: CameraEntry = CameraEntry()
    tools: tuple[ToolEntry, ...] = ()

    def tool(self, arm: str) -> ToolEntry:
        """Return the tool of an arm; InputError, which lists the arms, if there is none."""
        for tool in self.tools:
            if tool.arm == arm:
                return tool
        known = ", ".join(nearest_first(arm, [tool.arm for tool in self.tools])) or "none"
        raise InputError(f"{SESSION_FILE}: arm: expected one of {known}, got {arm!r}")


def read_session_toml(folder: str | Path) -> SessionEntries:
    """Read the session.toml of a folder; there are no entries without one.

    Raises
    ------
    InputError
        The file is no TOML file or too large, a key is unknown or has a value of another type, two tools have one arm
        or one label, or a tool among several has neither a label nor a folder of masks. The file is a link that leaves
        the folder.
    """
    root = Path(folder)
    path = root / SESSION_FILE
    if not os.path.lexists(path):
        return SessionEntries()
    check_own(root, [path])
    document = read_toml(path, expected="a session's description (TOML)")
    tables = document.get("tool")
    tools: list[object] = tables if isinstance(tables, list) else []
    _check_keys(f"{path}: unknown key ", document, ["camera", "tool"])
    _check_keys(f"{path}: unknown key camera.", document.get("camera"), [field.name for field in fields(CameraEntry)])
    for tool in tools:
        _check_keys(f"{path}: unknown key tool.", tool, [field.name for field in fields(ToolEntry)])
        if isinstance(tool, dict) and "label" in tool:
            tool["label"] = parse_label(f"{path}: tool.label", tool["label"])
    read = convert_document(str(path), document, SessionEntries, _EXPECTED)
    entries = SessionEntries(_within(root, read.camera), tuple(_within(root, tool) for tool in read.tools))
    if entries.camera.crop is not None:
        parse_crop(f"{path}: camera.crop", entries.camera.crop)
    _check_tools(path, entries.tools)
    return entries


def session_toml(camera: CameraEntry, tools: Sequence[ToolEntry]) -> str:
    """Return the text of a session.toml; relative paths are relative to the session's folder."""
    tables: list[tuple[str, CameraEntry | ToolEntry]] = [("[camera]", camera), *(("[[tool]]", tool) for tool in tools)]
    return "\n".join("\n".join([title, *_entries(table), ""]) for title, table in tables)


def _entries(table: CameraEntry | ToolEntry) -> Iterator[str]:
    """Yield the lines of a table, without the entries that have no value; texts of TOML have the escapes of JSON."""
    quoted = partial(json.dumps, ensure_ascii=False, default=str)
    for name, value in vars(table).items():
        if isinstance(value, dict) and value:
            yield f"{name} = {{{', '.join(f'{key} = {quoted(folder)}' for key, folder in value.items())}}}"
        elif value not in (None, False, (), {}):
            yield f"{name} = {quoted(value[0] if name == 'label' and len(value) == 1 else value)}"


def _check_keys(begin: str, table: object, known: Sequence[str]) -> None:
    """Raise an InputError for a key that a table does not have, with the nearest known ones."""
    for key in table if isinstance(table, dict) else ():
        if key not in known:
            raise InputError(f"{begin}{key}; the nearest known are {', '.join(nearest_first(key, known)[:3])}")


def _within(root: Path, entry: Entry) -> Entry:
    """Return an entry with its paths in the session's folder; the name of a bundled instrument is not a path."""
    changed: dict[str, Any] = {name: root / value for name, value in vars(entry).items() if isinstance(value, Path)}
    if isinstance(entry, ToolEntry):
        changed["packages"] = {name: root / folder for name, folder in entry.packages.items()}
        if entry.instrument is not None and entry.instrument.lower().endswith((".urdf", ".xml")):
            changed["instrument"] = str(root / entry.instrument)
    return replace(entry, **changed)


def _check_tools(path: Path, tools: tuple[ToolEntry, ...]) -> None:
    """Check that tools can be distinguished; errors as in `read_session_toml`."""
    arms: list[object] = [tool.arm for tool in tools]
    labels = [(tool.masks, tool.label, tool.pick) for tool in tools if tool.label is not None]
    for tool in tools:
        check_frame_name(tool.arm)
    for name, values in (("arm", arms), ("label", labels)):
        if len(set(values)) < len(values):
            raise InputError(f"{path}: tool.{name}: expected a different one for each tool, got {values}")
    for tool in tools:
        if len(tools) > 1 and tool.label is None and tool.masks is None:
            raise InputError(f"{path}: tool {tool.arm}: expected either a label or a folder of masks for each tool")
