"""Comparison of the frames of a results folder with each other: frames that stand apart get a reason in their file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from dvrk_cmaes.evaluate.fellows import PREFIX, base_doubts
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.results.paths import result_path
from dvrk_cmaes.results.result import Result, Status


def compare_frames(out: Path, results: Mapping[str, Result], limit_deg: float) -> dict[str, Result]:
    """Return results in which frames whose base is far from the others' are doubtful, and update their files.

    Reasons of an earlier comparison are replaced, so that the files depend only on the frames that are there.
    """
    doubts = base_doubts(results, limit_deg)
    compared = {}
    for name, result in results.items():
        own = [reason for reason in result.reasons if not reason.startswith(PREFIX)]
        reasons = (*own, *([doubts[name]] if name in doubts else ()))
        compared[name] = result
        if reasons != result.reasons:
            status: Status = "doubtful" if reasons else "ok"
            compared[name] = replace(result, status=status, reasons=reasons)
            path = result_path(out, name)
            document = read_json_object(path, expected="a result")
            write_json(path, {**document, "status": status, "reasons": list(reasons)})
    return compared
