"""What is asked of an export format, and what it returns, which the module of the format makes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Literal, cast

from dvrk_cmaes.export.base_choice import ChosenBase
from dvrk_cmaes.export.frames import FrameNames
from dvrk_cmaes.export.ros_topics import ToolTip
from dvrk_cmaes.export.source import ExportSource
from dvrk_cmaes.export.table import FORMATS
from dvrk_cmaes.geometry import Float64

DvrkVersion = Literal["2.4", "2.3"]


@dataclass(frozen=True, eq=False)
class ExportRequest:
    """The results to export, the name of the format, names of frames, and what single formats take.

    Parameters
    ----------
    source, to, names
        The results, the format and the names of frames.
    scene, obj
        The ids in the format bop.
    dvrk_version
        Version of the dVRK in the format dvrk.
    ecm_pose : (4, 4)
        In the format dvrk, ``local/measured_cp`` of the endoscope arm that holds the camera; None without one.
    times
        In the formats ros1-bag and ros2-bag, the frames' times, ns; empty if they are not known.
    tip
        In these formats, the tool tip frame of ``measured_cp``.
    table
        In the format lerobot, the parquet file of the episode.
    """

    source: ExportSource
    to: str
    names: FrameNames
    scene: int = 0
    obj: int = 1
    dvrk_version: DvrkVersion = "2.4"
    ecm_pose: Float64 | None = None
    times: Mapping[str, int] = field(default_factory=dict)
    tip: ToolTip = field(default_factory=ToolTip)
    table: Path | None = None


@dataclass(frozen=True, eq=False)
class Exported:
    """The files of an export.

    ``files`` are the contents by file name, ``base`` is the choice of ``camera_from_base`` if the format has one,
    ``left_out`` are the frames without a pose, and ``notes`` state what is missing.
    """

    files: dict[str, bytes]
    base: ChosenBase | None = None
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @staticmethod
    def of_texts(
        texts: Mapping[str, str], *, base: ChosenBase | None = None, left_out: tuple[str, ...] = ()
    ) -> Exported:
        """Return the export of texts by file name."""
        return Exported({name: text.encode() for name, text in texts.items()}, base, left_out)


def export(request: ExportRequest) -> Exported:
    """Make the files of a format.

    Raises
    ------
    InputError
        The source has no ``camera_from_base`` or no frames and the format requires them, or a name is not valid in it.
    """
    module = import_module(f"dvrk_cmaes.export.{FORMATS[request.to].module}")
    return cast(Exported, module.exported(request))
