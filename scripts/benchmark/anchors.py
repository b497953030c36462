"""Real recordings as tasks without a truth: what is to be put where, and what is measured of it.

Nothing is fetched: the pictures have no licence that lets others hand them on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from measure.places import SHARED
from measure.tables import Report

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.csv_file import number_in, read_csv_rows
from dvrk_cmaes.results.file import read_result


@dataclass(frozen=True)
class Anchor:
    """A recording: where it comes from, the files of its folder below ../shared/frames, and what measures it."""

    name: str
    source: str
    folder: str
    files: tuple[str, ...]
    measured: tuple[str, ...]


ANCHORS: Final = (
    Anchor(
        "paper",
        "github.com/hanyang-hu/bbox_dvrk_calibration",
        "real",
        (
            "easy/camera.yaml",
            "easy/joints.csv",
            "easy/masks",
            "medium/camera.yaml",
            "medium/joints.csv",
            "medium/masks",
        ),
        (
            "consistency of single frames: dvrk-cmaes batch FOLDER --out OUT; dvrk-cmaes consistency OUT",
            "left-out frames: dvrk-cmaes calibrate FOLDER --out OUT (leave_one_out in OUT/session.json)",
        ),
    ),
    Anchor(
        "bench b",
        "github.com/RANHAOHR/Global_Calibration at 9136fda",
        "bench/b",
        ("images/left", "images/right", "joints.csv", "left.yaml", "right.yaml"),
        (
            "left-out frames and both eyes: dvrk-cmaes calibrate FOLDER --out OUT (leave_one_out_of_views)",
            "the authors' own base: data/reference/bench.md",
        ),
    ),
    Anchor(
        "lincoln",
        "github.com/imanlab/d-lfd at 80d08e7",
        "labs/lincoln",
        ("by_hand/masks", "by_hand/ignore", "by_hand/joints.csv", "by_hand/camera.yaml", "shaft_by_stereo.csv"),
        ("shaft by both eyes: dvrk-cmaes batch FOLDER/by_hand --out OUT; python scripts/run_benchmark.py anchors OUT",),
    ),
)


def anchors() -> Report:
    """Return what is to be put where, whether it is there, and the commands that measure it."""
    report: dict[str, list[dict[str, str]]] = {}
    for anchor in ANCHORS:
        places = [SHARED / "frames" / anchor.folder / name for name in anchor.files]
        rows = [{"from": anchor.source, "put": str(path), "there": str(path.exists())} for path in places]
        report[anchor.name] = rows + [{"measured": how} for how in anchor.measured]
    return report


def shaft_report(results: Path, stereo: Path | None = None) -> Report:
    """Compare the shafts of results with those seen by both eyes: angle, and distance of the point from the axis.

    Raises
    ------
    InputError
        The file of shafts or a result is not readable, or no frame is in both.
    """
    path = SHARED / "frames" / "labs" / "lincoln" / "shaft_by_stereo.csv" if stereo is None else stereo
    _, lines = read_csv_rows(path, expected="shafts by stereo (CSV)")
    rows: list[dict[str, Any]] = []
    for where, cells in lines:
        file = results / "frames" / f"{cells['frame']}.json"
        result = read_result(file) if file.exists() else None
        if result is None or result.camera_from_root is None:
            continue
        axis = np.array([number_in(where, f"axis_{name}", cells) for name in "xyz"])
        point = np.array([number_in(where, f"point_{name}_m", cells, "metres") for name in "xyz"])
        own, root = result.camera_from_root[:3, 2], result.camera_from_root[:3, 3]
        along = float(np.clip(abs(axis @ own) / np.linalg.norm(axis), 0, 1))
        rows.append(
            {
                "frame": cells["frame"],
                "status": result.status,
                "shaft, deg": float(np.degrees(np.arccos(along))),
                "distance, mm": 1e3 * float(np.linalg.norm(np.cross(own, point - root))),
            }
        )
    if not rows:
        raise InputError(f"{results}: expected results of frames in {path}, got none")
    medians = {name: float(np.median([row[name] for row in rows])) for name in ("shaft, deg", "distance, mm")}
    return {"shafts": rows, "median": [{"frames": len(rows), **medians}]}
