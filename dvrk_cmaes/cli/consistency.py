"""``dvrk-cmaes consistency``: agreement of results over the frames of a session, and the paper's figures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from dvrk_cmaes.cli.options import OUTPUT, Flag
from dvrk_cmaes.cli.terminal import Line, answer, show, table_lines, warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.evaluate.agreement import Agreement


def consistency(
    *results: Path,
    session: Annotated[tuple[Path, ...], Parameter(negative=(), show_default=False)] = (),
    arm: Literal["classic", "si"] | None = None,
    tool: Path | None = None,
    picture: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Measure how well the frames of a session agree, without true poses: the paper's Table I and further measures.

    While the arm moves about its remote centre of motion (RCM), the shafts' axes should meet in one point x*. Sigma is
    the standard deviation of their distances from x*, in m as in the paper; rms is the root mean square of the
    distances. If all distances are equal, sigma is zero, but rms is not. If the axes turn by small angles only, x* is
    poorly determined along them and is not the RCM. If the insertion was read, the RCM is computed for each frame and
    should be one point. If all outer joints were read, the pose of the arm's base is computed for each frame and should
    be the same.

    Frames that were solved together (source "session") agree by construction. Only frames that were solved one by one
    can be compared with the paper.

    Example:

    ```
    dvrk-cmaes consistency out/easy out/medium --picture axes.svg
    ```

    Parameters
    ----------
    results
        Folders of results, written by this program or by any other that writes camera_from_root and joints; or
        the paper's poses as a published.csv.
    session
        Session folder or joints.csv whose readings are used instead of those in the results. May be given once for all
        results, or once for each of them in the same order.
    arm
        Arm whose kinematics are used. By default the arm stated in the results, or classic if none is stated.
    tool
        Description of the tool in the dVRK's format (JSON), for its roll offset (length along the shaft). By default
        the roll offset stated in the results, or that of the tools 400xxx if none is stated.
    picture
        File for a figure of the axes and of their distances from x*: .svg.
    json
        Print only the measures, as JSON, on stdout.
    """
    from dvrk_cmaes.evaluate.agreement import measure_agreement
    from dvrk_cmaes.evaluate.consistency import TABLE_ONE
    from dvrk_cmaes.evaluate.result_set import read_result_set
    from dvrk_cmaes.instrument.dvrk_description import read_tool
    from dvrk_cmaes.io.json_file import write_text
    from dvrk_cmaes.report.consistency_picture import draw_axes

    if not results:
        raise InputError("RESULTS: expected at least one folder of results, got none")
    if len(session) not in (0, 1, len(results)):
        raise InputError(f"--session: expected one, or one for each of the {len(results)} results, got {len(session)}")
    if picture is not None and picture.suffix.lower() != ".svg":
        raise InputError(f"{picture}: expected a picture's name to end in .svg, got {picture.suffix!r}")
    sources = session * len(results) if len(session) == 1 else session or (None,) * len(results)
    roll_offset = None if tool is None else read_tool(tool).roll_offset
    found = [
        measure_agreement(read_result_set(path, source), arm=arm, roll_offset=roll_offset)
        for path, source in zip(results, sources, strict=True)
    ]
    paper = {level: asdict(row) for level, row in TABLE_ONE.items()}
    answer({"sets": [spread.to_dict() for spread in found], "paper": paper}, _table(found), json=json)
    for spread in found:
        if spread.results.by_construction:
            instead = f"; one by one: {spread.results.alone}" if spread.results.alone else ""
            warn(
                f"{spread.results.name}: solved {spread.results.solved}: such frames agree by construction, which says "
                f"nothing about accuracy; no comparison with the paper's{instead}"
            )
    if picture is not None:
        write_text(picture, draw_axes(found))
        if not json:
            show([Line(f"written: {picture}")])
    return 0


def _table(found: Sequence[Agreement]) -> Iterator[Line]:
    """Yield a table with one row for each set of results, then the paper's rows and the frames without a pose."""
    from dvrk_cmaes.evaluate.consistency import TABLE_ONE
    from dvrk_cmaes.io.csv_file import Table

    rows: list[Sequence[str]] = []
    for spread in found:
        results, axes, rcm, base = spread.results, spread.axes, spread.rcm, spread.base
        of_bases = ("-", "-") if base is None else (f"{base.median_deg:.1f}", f"{base.largest_deg:.1f}")
        measures = f"{axes.sigma:.5f}", f"{1e3 * axes.rms:.2f}", f"{math.degrees(axes.turn):.1f}"
        point = " ".join(f"{1e3 * value:.1f}" for value in axes.point)
        spread_of_rcm = "-" if rcm is None else f"{1e3 * rcm.rms:.2f}"
        rows.append(
            (results.name, str(len(results.frames)), results.solved, *measures, spread_of_rcm, *of_bases, point)
        )
    for level, row in TABLE_ONE.items():
        for name, sigma in ((f"paper, {level}", row.sigma_m), (f"paper, {level}, PnP", row.pnp_sigma_m)):
            rows.append((name, "10", "one by one", f"{sigma:.5f}", *("",) * 6))
    yield Line("How well frames agree: sigma as the paper's Table I, the rest in mm and degrees", "bold")
    measured = "sigma, m", "rms", "axes' turn", "RCM spread", "base, median", "largest", "x* in the camera"
    yield from table_lines(Table(("results", "frames", "solved", *measured), rows))
    for spread in found:
        if spread.results.failed:
            yield Line(f"{spread.results.name}: without a pose, left out: {', '.join(spread.results.failed)}", "yellow")
        if spread.results.doubtful:
            yield Line(f"{spread.results.name}: doubtful, counted: {', '.join(spread.results.doubtful)}", "yellow")
