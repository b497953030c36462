"""Recordings of session folders: what each arm of a session sees, reads and truly does."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.frames.session_video import SessionVideo
from dvrk_cmaes.frames.tool_frames import frames_of_tool
from dvrk_cmaes.frames.truth import SessionTruth, read_golden
from dvrk_cmaes.instrument import Instrument

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recording:
    """A session with its truth; of a session of several arms, what one of them sees, reads and truly does."""

    session: Session
    arm: str | None = None

    @cached_property
    def name(self) -> str:
        """Name of the folder, and of the arm if there are several."""
        return " ".join([self.session.folder.resolve().name, *([] if self.arm is None else [self.arm])])

    @property
    def level(self) -> str:
        """The name up to its first digit."""
        return re.split(r"\d", self.name)[0] or self.name

    @property
    def golden(self) -> Path:
        """Path of the truth."""
        return self.session.folder / ("golden.json" if self.arm is None else f"golden_{self.arm}.json")

    @property
    def camera_from_base(self) -> Float64:
        """The true camera_from_base (4, 4); InputError if it is not known."""
        if self.session.truth.camera_from_base is None:
            raise InputError(f"{self.golden}: expected the truth of camera_from_base, got none")
        return self.session.truth.camera_from_base


def read_recordings(folder: str | Path, instrument: Instrument, video: SessionVideo | None = None) -> list[Recording]:
    """Read a session folder: its recording, or that of each arm if its session.toml names several."""
    entries = read_session_toml(folder)
    if entries is None or len(entries.tools) < 2:
        return [Recording(read_session(folder, known=instrument.joint_names, video=video))]
    found = []
    for tool in entries.tools:
        files = () if tool.joints is None else (tool.joints,)
        session = read_session(folder, known=instrument.joint_names, joints=files, video=video)
        one = Recording(frames_of_tool(session, entries, tool.arm), tool.arm)
        truth = read_golden(one.golden) if one.golden.exists() else SessionTruth()
        found.append(replace(one, session=replace(one.session, truth=truth)))
    return found
