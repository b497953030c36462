"""Tips and masks of a session whose tips are known: closed jaws that touch the corners of a printed board.

truth.csv of the session has the visible end of the jaws of each frame in the camera, m. The session is solved by
`calibrate`, with its masks or by images and readings alone; masks found in images are compared with the session's.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.seen_view import overlap_of
from dvrk_cmaes.results.folder import ALONE
from measuring.report import Report
from measuring.runner import solved

TRUTH = "truth.csv"


def tips_report(options: argparse.Namespace) -> Report:
    """Report a session's tips against the truth, across and along the line of sight, and the masks that were found.

    By ``images``, the session's masks are left out; further options go to `calibrate`.
    """
    folder, images = options.session, options.images
    if not (folder / TRUTH).is_file():
        raise InputError(f"{folder / TRUTH}: expected the tips of each frame (frame, x, y, z), got no file")
    with (folder / TRUTH).open(encoding="utf-8") as file:
        truth = {row["frame"]: np.array([float(row[axis]) for axis in "xyz"]) for row in csv.DictReader(file)}
    hidden = {TRUTH, "masks"} if images else {TRUTH}
    with tempfile.TemporaryDirectory() as place:
        session, out = Path(place, "session"), Path(place, "out")
        shutil.copytree(folder, session, ignore=lambda _, names: hidden.intersection(names))
        ran = solved(session, "calibrate", out, options.further)
        if ran.failures:
            raise InputError(f"{folder}: {ran.failures[0].error}")
        document, results = ran.document("session.json"), ran.documents()
        assert document is not None
        each: list[dict[str, Any]] = []
        for name, at in truth.items():
            row: dict[str, Any] = {"frame": name, "status": results[name]["status"], **_away(results[name]["tips"], at)}
            kept = [path / "masks" / f"{name}.png" for path in (out, out / ALONE)]
            found = next((path for path in kept if images and path.is_file()), None)
            known = folder / "masks" / f"{name}.png"
            row["mask IoU"] = None if found is None else overlap_of(read_mask(found), read_mask(known))
            each.append(row)
    along = np.array([row["depth mm"] for row in each if row["depth mm"] is not None])
    across = np.array([row["lateral mm"] for row in each if row["lateral mm"] is not None])
    overlaps = [row["mask IoU"] for row in each if row["mask IoU"] is not None]
    wrong = [row for row in each if row["status"] == "ok" and not _is_right(row)]
    contours = [one["contour_px"] for one in document["leave_one_out"].values()]
    return {
        "tips": [
            {
                "session": document["status"],
                "frames": len(each),
                "ok": sum(row["status"] == "ok" for row in each),
                "ok, beyond 2 mm across or 4 along": len(wrong),
                "lateral mm, median": float(np.median(across)),
                "lateral mm, worst": float(across.max()),
                "depth mm, mean": float(along.mean()),
                "depth mm, scatter": float(along.std()),
                "left-out contour px": float(np.median(contours)),
                "mask IoU, median": float(np.median(overlaps)) if overlaps else None,
            }
        ],
        "each": each,
    }


def _away(tips: Sequence[Sequence[float]] | None, truth: np.ndarray) -> dict[str, float | None]:
    """Return by how much the middle of the tips is off across and along the line of sight, mm."""
    if tips is None:
        return {"lateral mm": None, "depth mm": None}
    away, ray = 1e3 * (np.mean(tips, axis=0) - truth), truth / np.linalg.norm(truth)
    along = float(away @ ray)
    return {"lateral mm": float(np.linalg.norm(away - along * ray)), "depth mm": along}


def _is_right(row: dict[str, Any]) -> bool:
    return row["lateral mm"] is not None and row["lateral mm"] <= 2 and abs(row["depth mm"]) <= 4
