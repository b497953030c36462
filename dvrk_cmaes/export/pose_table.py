"""Export of results as a table: one row per frame, with the columns of `dvrk_cmaes.results.pose_rows`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dvrk_cmaes.export.request import Exported, ExportRequest
from dvrk_cmaes.io.csv_file import csv_text
from dvrk_cmaes.results.pose_rows import pose_rows


def table_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format rows with equal columns as CSV, None as a blank cell; an empty text for no rows."""
    if not rows:
        return ""
    return csv_text(list(rows[0]), ([*row.values()] for row in rows))


def exported(request: ExportRequest) -> Exported:
    """Export a row for each frame; InputError if there are no frames."""
    return Exported.of_texts({"poses.csv": table_text(pose_rows(request.source.poses()))})
