"""``dvrk-cmaes export``: results in the formats of other programs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from dvrk_cmaes.cli.options import OUTPUT, Flag
from dvrk_cmaes.cli.terminal import Line, note, show, warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.export.formats import Exported

NAMES = Group.create_ordered("Names")


def export(
    results: Path,
    /,
    *,
    to: Literal["dvrk", "easy-handeye", "tf", "bop", "csv", "tracker"],
    frame: str | None = None,
    arm: Annotated[str, Parameter(group=NAMES)] = "PSM1",
    camera_frame: Annotated[str, Parameter(group=NAMES)] = "camera",
    base_frame: Annotated[str | None, Parameter(group=NAMES)] = None,
    scene: Annotated[int, Parameter(group=NAMES)] = 0,
    object_id: Annotated[int, Parameter(group=NAMES)] = 1,
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Write results in the formats of other programs.

    Directions, a_from_b maps points of b into a:

    - dvrk: camera_from_base, two JSON files as dvrk_camera_registration names them: open-cv (camera x right, y down)
    and dVRK (x left, y up: diag(-1,-1,1,1) on the left); m.
    - easy-handeye: base_from_camera, an easy_handeye2 .calib of type eye_on_base; m.
    - tf: camera_from_base, a static_transform_publisher line of ROS 2, parent camera, child base; m. It goes to
    stdout, and into a file with --out.
    - bop: camera_from_root, results CSV of the BOP benchmark; mm. Where names of frames are no numbers, im_ids.csv says
    which is which.
    - csv: camera_from_root and camera_from_base, poses.csv, a wide table; mm, deg, quaternion xyzw.
    - tracker: camera_from_root, FRAME/optimized_ctr.npy and optimized_joint_angles.npy as online_dvrk_tracking reads
    them; m, rad.

    Which camera_from_base: the session calibration's (session.json) if there is one; else the one frame's; else the
    median of the frames that are ok, with its spread (of fewer than three, the doubtful ones count as well).

    Example:

    `dvrk-cmaes export results --to dvrk --arm PSM2 --out calibration`

    Parameters
    ----------
    results
        A folder of results, one result's JSON, or a session.json.
    to
        The format.
    frame
        Export this frame alone, even if there is a session calibration.
    arm
        The arm, in names of files and frames.
    camera_frame
        Name of the camera's optical frame (x right, y down, z forward).
    base_frame
        Name of the arm's base frame; ARM_base unless given.
    scene
        BOP's scene_id.
    object_id
        BOP's obj_id.
    out
        Folder to write to; "exports" in the folder of the results unless given.
    json
        Print as JSON, and nothing else, on stdout what was exported and where it was written.
    """
    if scene < 0 or object_id < 0:
        raise InputError(f"--scene, --object-id: expected whole numbers of at least 0, got {scene}, {object_id}")
    from dvrk_cmaes.export.formats import DIRECTIONS
    from dvrk_cmaes.export.formats import export as exported_files
    from dvrk_cmaes.export.frames import FrameNames
    from dvrk_cmaes.export.source import read_source
    from dvrk_cmaes.io.atomic import json_text, write_bytes

    names = FrameNames(arm, camera_frame, f"{arm}_base" if base_frame is None else base_frame)
    exported = exported_files(read_source(results, frame), to, names, scene=scene, obj=object_id)
    folder = _home(results) / "exports" if out is None else out
    to_stdout = to == "tf" and out is None
    written = [] if to_stdout else [folder / name for name in exported.files]
    for path, data in zip(written, exported.files.values(), strict=False):
        write_bytes(path, data)
    for text in _warnings(exported):
        warn(text)
    if json:
        document: dict[str, Any] = {"to": to, "direction": DIRECTIONS[to], "written": [str(path) for path in written]}
        if to == "tf":
            document["command"] = _line(exported)
        if exported.base is not None:
            document["base"] = exported.base.to_dict()
        print(json_text({**document, "left_out": list(exported.left_out)}), end="")
    elif to == "tf":
        note(_origin(exported))
        print(_line(exported))
    else:
        show(_said(exported, DIRECTIONS[to], written))
    return 0


def _home(results: Path) -> Path:
    """Folder of the results that a path belongs to: above ``frames``, for one result's file."""
    if results.is_dir():
        return results
    return results.parent.parent if results.parent.name == "frames" else results.parent


def _line(exported: Exported) -> str:
    """Text of the one file of one line."""
    (data,) = exported.files.values()
    return data.decode().rstrip("\n")


def _origin(exported: Exported) -> str:
    return "" if exported.base is None else f"camera_from_base: {exported.base.origin}"


def _said(exported: Exported, direction: str, written: list[Path]) -> Iterator[Line]:
    if exported.base is not None:
        yield Line(_origin(exported))
    yield Line(f"exported: {direction}")
    few = written if len(written) <= 4 else written[:3]
    for path in few:
        yield Line(f"written: {path}")
    if len(few) < len(written):
        yield Line(f"written: {len(written) - len(few)} more files")


def _warnings(exported: Exported) -> Iterator[str]:
    if exported.base is not None:
        yield from exported.base.warnings
    if exported.left_out:
        from dvrk_cmaes.io.short_text import listed

        yield f"no pose, left out ({len(exported.left_out)}): {listed(exported.left_out)}"
