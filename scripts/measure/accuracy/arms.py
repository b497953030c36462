"""Two arms that cross: each tool with the other before or beside it, against the same tool alone.

The sessions are those of `dvrk-cmaes synth --arms 2`, which have the masks of each tool without the other as well.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.frame import FrameData, FrameFiles, read_frame
from dvrk_cmaes.geometry import change_between, inverse
from dvrk_cmaes.results.folder import ARMS
from measure.accuracy.errors import Compared, compared
from measure.accuracy.figures import percentiles
from measure.cases import Case, Measurement, grouped

CROSSED: Final = "with the other tool"
ALONE: Final = "alone"


def arms_report(given: Measurement) -> dict[str, list[dict[str, Any]]]:
    """Estimate every tool of the sessions with and without the other, and return tables of their errors.

    With the other tool, its pixels do not count.

    Raises
    ------
    InputError
        A session names no tools, has no masks of the tools alone or no truth, or an estimate has no pose.
    """
    for one in given.recordings():
        if one.arm is None:
            raise InputError(f"{one.session.folder}: expected a session.toml that names several tools, got none")
    cases = [replace(case, kind=CROSSED) for case in given.cases()]
    alone = [replace(case, kind=ALONE, data=_alone(case)) for case in cases]
    whole = [_read(case, other_tools=()) for case in cases]
    found = grouped(compared(given.instrument, given.runs([*cases, *alone])), lambda one: one.run.case.kind)
    hidden = [1 - float(a.mask.sum() / b.mask.sum()) for a, b in zip(whole, alone, strict=True)]
    rows = [_summary(kind, found[kind], max(hidden)) for kind in (CROSSED, ALONE)]
    median = rows[-1]["tip_mm"][0]
    ratios = [{"tool": row["tool"], "tips median": round(row["tip_mm"][0] / median, 3)} for row in rows[:-1]]
    return {"estimates": rows, "against alone": ratios}


def _files(case: Case) -> FrameFiles:
    """Return the files of a case's frame."""
    return next(files for files in case.recording.session.frames if files.name == case.frame)


def _read(case: Case, **changes: Any) -> FrameData:
    """Read a case's frame again, in its first view, with other files."""
    return read_frame(replace(_files(case), keypoints=None, **changes), case.recording.session.camera)


def _alone(case: Case) -> FrameData:
    """Read a case's frame as if the other tools were not there."""
    session, arm = case.recording.session, case.recording.arm
    mask = session.folder / "alone" / str(arm) / session.view_names[0] / f"{case.frame}.png"
    return _read(case, mask=mask, label=None, other_tools=())


def _summary(kind: str, found: Sequence[Compared], hidden: float) -> dict[str, Any]:
    """Return shares, percentiles (50, 90, 100) and means of the errors of estimates of one kind."""
    return {
        "tool": kind,
        "estimates": len(found),
        "hidden, largest": round(hidden, 3),
        "right mode": sum(one.right_mode for one in found),
        "tip_mm": percentiles([one.tip_mm for one in found]),
        "mean_mm": round(float(np.mean([one.tip_mm for one in found])), 3),
        "ok": sum(one.run.trusted for one in found),
        "ok, more than 3 mm off": sum(one.run.trusted and one.tip_mm > 3 for one in found),
    }


def bases_report(given: Measurement, every: int = 1) -> dict[str, list[dict[str, Any]]]:
    """Calibrate sessions of several arms by the command, and compare how their bases lie to each other with the truth.

    Every N-th frame is calibrated. Results are kept in the given folder, by default in one that is removed.

    Raises
    ------
    DvrkCmaesError
        A session could not be calibrated.
    """
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for folder in map(Path, given.folders):
            out = (Path(temporary) if given.keep is None else given.keep) / folder.name
            command = [sys.executable, "-m", "dvrk_cmaes", "calibrate", str(folder), "--out", str(out), "--json"]
            command += ["--workers", str(given.workers), "--every", str(every)]
            done = subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
            if not (out / ARMS).is_file():
                raise DvrkCmaesError(f"{folder}: calibrate ended with {done.returncode}")
            document = json.loads((out / ARMS).read_text(encoding="utf-8"))
            truths = {path.stem.removeprefix("golden_"): path for path in folder.glob("golden_*.json")}
            golden = {arm: json.loads(path.read_text(encoding="utf-8")) for arm, path in truths.items()}
            rows += [{"session": folder.name, **row} for row in base_rows(document, golden)]
    total = {
        "bases": len(rows),
        "off, mm, median": float(np.median([row["off, mm"] for row in rows])),
        "within 3 std": sum(row["largest, std"] <= 3.0 for row in rows),
    }
    return {"bases": rows, "all": [total]}


def base_rows(document: Mapping[str, Any], golden: Mapping[str, Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the errors of the bases of arms.json in that of its reference arm, given the arms' golden.json by name."""
    for arm, found in document["arms"].items():
        one, other = (_true_base(golden[name]) for name in (document["reference"], arm))
        off = change_between(np.array(found["reference_from_base"]), inverse(one) @ other)
        std = np.sqrt(np.diag(found["covariance"]))
        yield {
            "arm": arm,
            "off, mm": 1e3 * float(np.linalg.norm(off[:3])),
            "off, deg": float(np.degrees(np.linalg.norm(off[3:]))),
            "std, mm": 1e3 * float(np.linalg.norm(std[:3])),
            "largest, std": float((np.abs(off) / std).max()),
        }


def _true_base(golden: Mapping[str, Any]) -> np.ndarray:
    """Return an arm's true base (4, 4) in the camera, or in the base of the endoscope's arm where that was steered."""
    return np.array(golden["endoscope"]["ecm_from_base"] if "endoscope" in golden else golden["camera_from_base"])
