"""``dvrk-cmaes pnp``: baseline poses of a session from image points, by OpenCV's PnP solvers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    FRAME,
    OUTPUT,
    CameraOptions,
    InstrumentOptions,
    SessionOptions,
)
from dvrk_cmaes.cli.session_tools import open_session
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, exit_code, show
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.results.result import Result
    from dvrk_cmaes.runs.frame import ArmInSession


def pnp(
    session: Path,
    /,
    *,
    out: Annotated[Path, Parameter(group=OUTPUT)],
    points: Annotated[Literal["markers", "tips"], Parameter(group=FRAME)] = "markers",
    solver: Annotated[Literal["sqpnp", "ransac"], Parameter(group=FRAME)] = "sqpnp",
    markers: Annotated[Path | None, Parameter(group=FRAME)] = None,
    camera: CameraOptions = CameraOptions(),
    instrument: InstrumentOptions = InstrumentOptions(),
) -> int:
    """Estimate the poses of a session from image points and readings by PnP, as a baseline for comparisons.

    Earlier trackers are initialised in this way. The joints are the readings, without correction. Results are written
    to OUT/frames/FRAME.json in the schema of `estimate`, so that they can be compared by the same commands. Exit codes:
    0 ok, 1 every frame failed, 2 wrong usage or input, 3 a frame is doubtful or failed.

    Example:

    ```
    dvrk-cmaes pnp sessions/hard --out pnp/hard --solver ransac
    ```

    Parameters
    ----------
    session
        Session folder with markers.csv (columns frame, marker, u, v) for --points markers, or with keypoints.csv and
        masks for --points tips.
    out
        Folder for frames/FRAME.json.
    points
        Points to use. markers: detected painted markers. tips: the two jaw tips and the edges of the shaft.
    solver
        PnP solver for markers. sqpnp: SQPNP on all points, then Levenberg-Marquardt. ransac: RANSAC, then the iterative
        solver on the inliers.
    markers
        Positions of the markers on the links: JSON of link and position_m (metres) by name of the marker. By default a
        bundled table of the painted markers of the Large Needle Driver.
    camera
        The camera.
    instrument
        The instrument.
    """
    from dvrk_cmaes.io.json_file import write_json
    from dvrk_cmaes.io.output import output
    from dvrk_cmaes.results.folder import check_output, result_path

    (arm,) = open_session(session, SessionOptions(camera=camera, instrument=instrument), single=True).values()
    for frame in arm.session.frames:
        check_output(out, frame.name)
    with output(out, "pnp") as own:
        own.refuse(result_path(Path(), frame.name).as_posix() for frame in arm.session.frames)
        results = list(_by_tips(arm) if points == "tips" else _by_markers(arm, solver, markers))
        for result in results:
            write_json(result_path(out, result.frame), result.to_dict())
    show(_lines(results, out))
    return exit_code(result.status for result in results)


def _by_markers(arm: ArmInSession, solver: Literal["sqpnp", "ransac"], markers: Path | None) -> Iterator[Result]:
    """Yield a result for each frame from the markers in the session's markers.csv."""
    from dvrk_cmaes.estimation.pnp.frame import pose_from_markers
    from dvrk_cmaes.frames.markers import read_detections, read_marker_table
    from dvrk_cmaes.io.files import bundled_path

    table = read_marker_table(markers or bundled_path("markers", "lnd.json"))
    session, model = arm.session, arm.body.instrument
    path = session.folder / "markers.csv"
    seen = read_detections(path)
    unknown = sorted({name for row in seen.values() for name in row} - set(table))
    if unknown:
        raise InputError(f"{path}: marker: expected one of {', '.join(table)}, got {unknown[0]!r}")
    for files in session.frames:
        yield pose_from_markers(
            files, session.camera, model, table, seen.get(files.name, {}), solver=solver, arm=arm.method.arm
        )


def _by_tips(arm: ArmInSession) -> Iterator[Result]:
    """Yield a result for each frame from its jaw tips and shaft edges."""
    from dvrk_cmaes.estimation.pnp.frame import pose_from_tips
    from dvrk_cmaes.frames.frame import read_frame

    for files in arm.session.frames:
        data = read_frame(files, arm.session.camera)
        yield pose_from_tips(data, arm.body.instrument, arm=arm.method.arm)


def _lines(results: list[Result], out: Path) -> Iterator[Line]:
    """Yield the status of each frame, the number of ok frames, and the folder of the results."""
    for result in results:
        reasons = "".join(f", {reason}" for reason in result.reasons)
        yield Line(f"{result.frame}: {result.status}{reasons}", STATUS_STYLES[result.status] if reasons else "")
    ok = sum(result.status == "ok" for result in results)
    yield Line(f"{ok} of {len(results)} frames ok; written: {out / 'frames'}")
