"""Export of results into an episode of a LeRobot data set: its table with further columns, beside the original ones.

The columns begin with the arm's name, such as ``psm1_corrected.``: ``yaw`` ... ``jaw`` (rad; insertion: m), joints as
the results have them, of the outer ones the readings with the session's offsets; ``camera_from_base`` (16, rows of
4 x 4, m), ``lag_s``, of the images behind the readings that was taken out, ``status`` and ``tip_probability``. Rows
without a result have nulls.
"""

from __future__ import annotations

import io
from typing import Any

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.export.base_choice import ChosenBase
from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.io.parquet_file import opened
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.rows import number_of
from dvrk_cmaes.results.result import Result

_ROW = "frame_index"


def exported(request: ExportRequest) -> Exported:
    """Export the table of an episode; InputError without one, or if its rows are not those of the results' frames."""
    path, results = request.table, {number_of(result.frame): result for result in request.source.poses()}
    if path is None:
        raise InputError("--table: expected the parquet file of the episode with --to lerobot, got none")
    with opened(path) as file:
        table = file.read()
    rows = table.to_pydict().get(_ROW, []) if _ROW in table.column_names else []
    if len({*rows}) < len(rows) or not {*rows} & {*results}:
        frames = listed(result.frame for result in results.values())
        raise InputError(f"{path}: {_ROW}: expected one episode with rows of the frames {frames}, got others")
    import pyarrow as pa
    from pyarrow import parquet

    session, base = request.source.session or {}, request.source.base() if request.source.has_base() else None
    cells = [_cells(results[k], session, base) if k in results else {} for k in rows]
    for name in dict.fromkeys(name for row in cells for name in row):
        column = f"{request.names.arm.lower()}_corrected.{name}"
        table = table.append_column(column, pa.array([row.get(name) for row in cells]))
    stream = io.BytesIO()
    parquet.write_table(table, stream)
    return Exported({path.name: stream.getvalue()}, base, request.source.without_pose)


def _cells(result: Result, session: dict[str, Any], base: ChosenBase | None) -> dict[str, Any]:
    """Return what the row of a frame gets, by the name of the column."""
    offsets, lag = session.get("offsets", {}), session.get("lag") or {}
    outer = {name: value + offsets.get(name, 0.0) for name, value in result.readings.items()}
    return {
        **outer,
        **result.joints,
        "camera_from_base": None if base is None else base.camera_from_base.ravel().tolist(),
        "lag_s": lag.get("seconds") if lag.get("applied") else None,
        "status": result.status,
        "tip_probability": result.tip_probability,
    }
