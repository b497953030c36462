"""``dvrk-cmaes export``: results in the formats of other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from dvrk_cmaes.cli.options import OUTPUT, Flag, options, whole
from dvrk_cmaes.cli.terminal import Line, note, show, warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.table import FORMATS
from dvrk_cmaes.io.short_text import listed

if TYPE_CHECKING:
    from dvrk_cmaes.export.request import Exported
    from dvrk_cmaes.export.ros_topics import ToolTip
    from dvrk_cmaes.results.result import Result

if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(sorted(FORMATS))]

NAMES = Group.create_ordered("Names")
DVRK = Group.create_ordered("dVRK")
BAG = Group.create_ordered("ROS recording")
_MOST_NAMED = 4  # files that are written


@options(group=BAG)
class BagOptions:
    """Options of ROS recordings.

    Parameters
    ----------
    times
        Table of the frames' times (images.csv with the columns frame and time), or a session folder with one. By
        default the times at the end of the frames' names, or those in the results, or if there are none, one second
        between frames.
    tool
        Description of the tool in the dVRK's format (JSON), whose tip measured_cp is the pose of. A Large Needle Driver
        400006 by default.
    """

    times: Path | None = None
    tool: Path | None = None

    def read_times(self, results: Sequence[Result]) -> dict[str, int]:
        """Return the times of frames, ns, from the table, their names or the results; empty if some have none."""
        from dvrk_cmaes.joints.interpolation import NANOSECONDS
        from dvrk_cmaes.joints.times import read_image_times, time_in_name

        if self.times is not None:
            return read_image_times(self.times / "images.csv" if self.times.is_dir() else self.times)
        named = {result.frame: time_in_name(result.frame) for result in results}
        stated = {result.frame: None if result.time is None else round(result.time * NANOSECONDS) for result in results}
        for times in (named, stated):
            known = {frame: time for frame, time in times.items() if time is not None}
            if len(known) == len(results):
                return known
        return {}

    def read_tip(self) -> ToolTip:
        """Return the tool tip frame of the tool."""
        from dvrk_cmaes.export.ros_topics import ToolTip
        from dvrk_cmaes.instrument.dvrk_description import Tool, read_tool

        tool = Tool() if self.tool is None else read_tool(self.tool)
        return ToolTip(tool.wrist_length, tool.tooltip_offset)


@options(group=OUTPUT)
class FormatGiven:
    """The format, and the names in it.

    Parameters
    ----------
    to
        Format to write.
    table
        The parquet file of a LeRobot data set's episode, in the format lerobot.
    arm
        Name of the arm in names of files and frames.
    camera_frame
        Name of the camera's optical frame (x right, y down, z forward).
    base_frame
        Name of the arm's base frame; ARM_base by default.
    scene
        scene_id in the format bop.
    object_id
        obj_id in the format bop.
    dvrk_version
        Version of the dVRK that reads the arm's base frame: 2.4 in system.json, 2.3 or older in console.json.
    ecm_pose
        For an endoscope held by an arm (ECM): file of its local/measured_cp while the frames were recorded, as printed
        by `ros2 topic echo --once /ECM/local/measured_cp`, or JSON with measured_cp, 4 rows of 4 numbers. The format
        dvrk then has suj-fixed.json: the pose of the arm's base in that of the ECM.
    """

    to: Format
    table: Path | None = None
    arm: Annotated[str, Parameter(group=NAMES)] = "PSM1"
    camera_frame: Annotated[str, Parameter(group=NAMES)] = "camera"
    base_frame: Annotated[str | None, Parameter(group=NAMES)] = None
    scene: Annotated[int, whole(0, group=NAMES)] = 0
    object_id: Annotated[int, whole(0, group=NAMES)] = 1
    dvrk_version: Annotated[Literal["2.4", "2.3"], Parameter(group=DVRK)] = "2.4"
    ecm_pose: Annotated[Path | None, Parameter(group=DVRK)] = None


def export(
    results: Path,
    /,
    *,
    chosen: FormatGiven,
    frame: str | None = None,
    bag: BagOptions = BagOptions(),
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Write results in the formats of other programs.

    Formats, with the transform and its units (a_from_b maps points of b into a):

    FORMATS

    camera_from_base is that of the session calibration (session.json) if there is one, otherwise that of the frame if
    there is only one, otherwise the median of the ok frames, whose scatter is printed (with fewer than three ok frames,
    the doubtful ones are included).

    Example:

    ```
    dvrk-cmaes export results --to dvrk --arm PSM2 --out calibration
    ```

    Parameters
    ----------
    results
        Folder of results, JSON file of one result, or session.json. Of a folder with the results of several arms, those
        of --arm.
    chosen
        The format, and the names in it.
    frame
        Name of the only frame to export; a session calibration is then not used. By default all frames.
    bag
        The frames' times and the tool.
    out
        Folder for the files written; by default "exports" in the folder of the results (tf: no file).
    json
        Print only a summary, as JSON, on stdout: what was exported and the files written.
    """
    if chosen.ecm_pose is not None and chosen.to != "dvrk":
        raise InputError(f"--ecm-pose: expected the format dvrk, got --to {chosen.to}")
    if bag != BagOptions() and chosen.to not in ("ros1-bag", "ros2-bag") and (chosen.to, bag.tool) != ("tum", None):
        raise InputError(f"--times, --tool: expected the format ros1-bag or ros2-bag, got --to {chosen.to}")
    from dvrk_cmaes.cli.session_tools import output_folder
    from dvrk_cmaes.export.cartesian_pose import read_cartesian_pose
    from dvrk_cmaes.export.frames import FrameNames
    from dvrk_cmaes.export.request import ExportRequest
    from dvrk_cmaes.export.request import export as exported_files
    from dvrk_cmaes.export.source import read_source
    from dvrk_cmaes.io.output import LONG, output, write_bytes
    from dvrk_cmaes.results.folder import folder_of_arm

    results = folder_of_arm(results, chosen.arm)
    base_frame = f"{chosen.arm}_base" if chosen.base_frame is None else chosen.base_frame
    names = FrameNames(chosen.arm, chosen.camera_frame, base_frame)
    pose = None if chosen.ecm_pose is None else read_cartesian_pose(chosen.ecm_pose)
    source = read_source(results, frame)
    times = bag.read_times(source.results)
    taken = chosen.scene, chosen.object_id, chosen.dvrk_version, pose, times, bag.read_tip(), chosen.table
    exported = exported_files(ExportRequest(source, chosen.to, names, *taken))
    written = []
    if chosen.to != "tf" or out is not None:
        with (
            output_folder(out, _results_folder(results), "exports", "export", wait=LONG) as folder,
            output(folder, "export") as own,
        ):
            own.refuse(exported.files)
            written = [folder / name for name in exported.files]
            for path, data in zip(written, exported.files.values(), strict=True):
                write_bytes(path, data)
    _report(exported, chosen.to, written, json=json)
    return 0


export.__doc__ = (export.__doc__ or "").replace(
    "    FORMATS\n", "".join(f"    - {row.name}: {row.content}\n" for row in FORMATS.values())
)


def _results_folder(results: Path) -> Path:
    """Return the folder of results that a path belongs to; for a file in ``frames``, the folder above."""
    if results.is_dir():
        return results
    return results.parent.parent if results.parent.name == "frames" else results.parent


def _report(exported: Exported, to: str, written: Sequence[Path], *, json: bool) -> None:
    """Print what was exported, in the format tf the lines of its files, and warnings."""
    base, direction = exported.base, FORMATS[to].direction
    origin = "" if base is None else f"camera_from_base: {base.origin}"
    for text in (*(() if base is None else base.warnings), *exported.notes):
        warn(text)
    if exported.left_out:
        warn(f"no pose, left out ({len(exported.left_out)}): {listed(exported.left_out)}")
    publishers = "".join(data.decode() for data in exported.files.values()).rstrip("\n") if to == "tf" else ""
    if json:
        from dvrk_cmaes.io.json_file import json_text

        document: dict[str, Any] = {"to": to, "direction": direction, "written": [str(path) for path in written]}
        document |= {"command": publishers} if to == "tf" else {}
        document |= {} if base is None else {"base": base.to_dict()}
        print(json_text({**document, "left_out": list(exported.left_out)}), end="")
    elif to == "tf":
        note(origin)
        print(publishers)
    else:
        few = written if len(written) <= _MOST_NAMED else written[: _MOST_NAMED - 1]
        files = [*map(str, few), *([f"{len(written) - len(few)} more files"] if few != written else [])]
        lines = *([origin] if origin else []), f"exported: {direction}", *(f"written: {name}" for name in files)
        show(map(Line, lines))
