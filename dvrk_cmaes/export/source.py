"""Reading of the source of an export: a folder of results, one result, or a session calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.export.base_choice import ChosenBase, base_of_frame, base_of_frames, base_of_session, bases_of_arms
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.results.folder import ARMS, SESSION, check_frame_name, is_followed, read_results, result_paths
from dvrk_cmaes.results.result import Result

_EXPECTED = "a result or a session calibration (JSON), or a folder of them"


@dataclass(frozen=True, eq=False)
class ExportSource:
    """The results and session calibration to export.

    Parameters
    ----------
    path
        Path of the source.
    results
        Results sorted by frame name; empty for a session calibration without results.
    session
        Document of the session calibration, or None.
    single
        Whether one result was selected, as a file or by frame name.
    """

    path: Path
    results: Sequence[Result]
    session: dict[str, Any] | None
    single: bool

    def poses(self) -> Sequence[Result]:
        """Return the results; InputError if there are none or a frame's name is not valid as a file's name."""
        if not self.results:
            raise InputError(f"{self.path}: expected results of frames, got a session calibration only")
        for result in self.results:
            check_frame_name(result.frame)
        return self.results

    @property
    def without_pose(self) -> tuple[str, ...]:
        """Names of the frames that have no pose."""
        return tuple(result.frame for result in self.results if result.camera_from_root is None)

    def has_base(self) -> bool:
        """Whether there is a session calibration, or a frame with a ``camera_from_base`` that did not fail."""
        known = (result.camera_from_base is not None and result.status != "failed" for result in self.results)
        return self.session is not None or any(known)

    def calibration(self) -> tuple[str, dict[str, Any]]:
        """Return the path of the session calibration, for messages, and its document; InputError if there is none."""
        if self.session is None:
            raise InputError(f"{self.path}: expected a session calibration (session.json), got none: run calibrate")
        return str(self.path / SESSION if self.path.is_dir() else self.path), self.session

    def base(self) -> ChosenBase:
        """Choose ``camera_from_base`` by the rules of ``base_choice``; InputError if there is none."""
        if self.session is not None:
            return base_of_session(*self.calibration(), self._other_arms())
        if self.single:
            return base_of_frame(str(self.path), self.results[0])
        return base_of_frames(str(self.path), self.results)

    def _other_arms(self) -> dict[str, Float64]:
        """Return the bases of the session's other arms in that of the endoscope's arm, where arms.json has them."""
        folder = self.path if self.path.is_dir() else self.path.parent
        path = folder.parent / ARMS
        if not path.is_file():
            return {}
        bases = bases_of_arms(str(path), read_json_object(path, expected="the bases of several arms"))
        return {name: base for name, base in bases.items() if name != folder.name} if folder.name in bases else {}


def read_source(path: Path, frame: str | None = None) -> ExportSource:
    """Read the source at a path; with ``frame``, the result of that frame only.

    A JSON file with ``camera_from_base`` and without ``camera_from_root`` is a session calibration.

    Raises
    ------
    InputError
        A file is not valid, or the frame is not among the results.
    """
    if path.is_dir():
        return _folder(path, frame)
    document = read_json_object(path, expected=_EXPECTED)
    if "camera_from_root" not in document and "camera_from_base" in document:
        if frame is not None:
            raise InputError(f"--frame: expected no frame of a session calibration, got {shown(frame)}")
        return ExportSource(path, (), document, single=False)
    if document.get("frame") is None:
        document["frame"] = path.stem
    result = Result.from_dict(document, where=str(path))
    if frame is not None and frame != result.frame:
        raise InputError(f"{path}: frame: expected {shown(frame)}, got {shown(result.frame)}")
    return ExportSource(path, (result,), None, single=True)


def _folder(path: Path, frame: str | None) -> ExportSource:
    """Read a folder of results, with or without a session calibration."""
    if frame is None and (path / SESSION).exists() and not is_followed(path) and not result_paths(path):
        session = read_json_object(path / SESSION, expected="a session calibration (session.json)")
        return ExportSource(path, (), session, single=False)
    folder = read_results(path)
    if frame is None:
        return ExportSource(path, tuple(folder.frames.values()), folder.session, single=False)
    if frame not in folder.frames:
        near = listed(nearest_first(frame, folder.frames))
        raise InputError(f"{path}: frame: expected one of {len(folder.frames)} frames ({near}), got {shown(frame)}")
    return ExportSource(path, (folder.frames[frame],), None, single=True)
