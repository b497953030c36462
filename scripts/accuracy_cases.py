"""Frames for measurements of accuracy, read from session folders, and their estimates in parallel processes.

A case is a frame in memory, original or falsified, with its truth. A run is the result of a case. Each worker process
uses one thread.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from accuracy_features import measure_features
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.estimation import estimate
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.frames.truth import FrameTruth
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.silhouette.prepare import prepare

Float64 = NDArray[np.float64]

ORIGINAL: Final = "honest"  # kind of a case that is not falsified
CRASHED: Final = "crashed"  # status of a run that ended with an unexpected exception


@dataclass(frozen=True, eq=False)
class Case:
    """Input of one estimate.

    ``level`` is the session's name up to its first digit. ``kind`` states what was falsified; it is ``ORIGINAL`` if
    nothing was. ``truth`` is that of the original frame. Readings are in rad and m.
    """

    session: str
    frame: str
    level: str
    kind: str
    mask: NDArray[np.bool_]
    camera: Camera
    readings: Mapping[str, float]
    truth: FrameTruth | None
    ignore: NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class Run:
    """Result of a case: its JSON, and features from which thresholds for doubt are chosen."""

    case: Case
    result: Mapping[str, Any]
    features: Mapping[str, float]

    @property
    def failed(self) -> bool:
        """Whether the result has no pose."""
        return self.result["status"] in ("failed", CRASHED)

    @property
    def trusted(self) -> bool:
        """Whether the status is ok."""
        return bool(self.result["status"] == "ok")

    @property
    def doubted(self) -> bool:
        """Whether the status is doubtful or failed; not for a crash."""
        return self.result["status"] in ("failed", "doubtful")

    @property
    def pose(self) -> Float64:
        """Estimated ``camera_from_root`` (4, 4)."""
        return np.array(self.result["camera_from_root"], dtype=np.float64)

    @property
    def joints(self) -> Mapping[str, float]:
        """Estimated joints by name, rad."""
        joints: Mapping[str, float] = self.result["joints"]
        return joints

    @property
    def covariance(self) -> Float64:
        """Covariance (6 + J, 6 + J) of small changes [t, r, joints] in the root's axes, m and rad."""
        return np.array(self.result["covariance"]["matrix"], dtype=np.float64)


def read_cases(folders: Sequence[str], *, instrument: str, frames: int | None, truth: bool = True) -> list[Case]:
    """Read the frames of session folders; at most ``frames`` of each, evenly spread.

    A frame that cannot be used, for example with an empty mask where the instrument has left the view, is left out with
    a line on stderr.

    Raises
    ------
    InputError
        A session cannot be read, no frame of it can be used, two sessions have the same name, or with ``truth`` a frame
        has no truth.
    """
    known = prepare(instrument).instrument.joint_names
    cases: list[Case] = []
    for folder in folders:
        session = read_session(folder, known=known)
        name = session.folder.resolve().name
        if any(case.session == name for case in cases):
            raise InputError(f"{folder}: expected sessions of different names, got {name} twice")
        files = session.frames
        if frames is not None and frames < len(files):
            files = tuple(files[i * len(files) // frames] for i in range(frames))
        for one in files:
            if truth and one.name not in session.truth.frames:
                raise InputError(f"{session.folder / 'golden.json'}: expected the truth of frame {one.name}, got none")
            try:
                data = read_frame(one, session.camera)
            except InputError as error:
                print(f"{name}: frame {one.name} is left out: {error}", file=sys.stderr)
                continue
            cases.append(
                Case(
                    session=name,
                    frame=one.name,
                    level=re.split(r"\d", name)[0] or name,
                    kind=ORIGINAL,
                    mask=data.mask,
                    camera=data.camera,
                    readings=one.readings,
                    truth=session.truth.frames.get(one.name),
                    ignore=data.ignore,
                )
            )
        if not any(case.session == name for case in cases):
            raise InputError(f"{folder}: expected a frame that can be used, got none of {len(files)}")
    return cases


def run_cases(
    cases: Sequence[Case],
    *,
    instrument: str,
    config: EstimateConfig,
    workers: int,
    keep: Path | None = None,
    label: str = "frames",
) -> list[Run]:
    """Estimate all cases, in their order; with ``keep``, write results to that folder and reuse those in it."""
    done: dict[int, Run] = {}
    for i, case in enumerate(cases):
        path = _kept_path(keep, case)
        if path is not None and path.exists():
            kept = json.loads(path.read_text(encoding="utf-8"))
            done[i] = Run(case, kept["result"], kept["features"])
    left = [i for i in range(len(cases)) if i not in done]
    if left:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ[name] = "1"  # inherited by the workers, whose libraries read it when they are loaded
        context = multiprocessing.get_context("spawn")
        single = replace(config, threads=1)
        with ProcessPoolExecutor(workers, context, initializer=_prepare, initargs=(instrument,)) as pool:
            futures = {pool.submit(_run, cases[i], single): i for i in left}
            try:
                for count, future in enumerate(as_completed(futures), start=1):
                    i = futures[future]
                    done[i] = Run(cases[i], *future.result())
                    path = _kept_path(keep, cases[i])
                    if path is not None:
                        write_json(path, {"result": done[i].result, "features": done[i].features})
                    print_progress(label, count, len(left))
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    return [done[i] for i in range(len(cases))]


def print_progress(label: str, count: int, total: int) -> None:
    """Print progress on stderr: on a terminal always in the same line, otherwise a line for every 20th item."""
    if sys.stderr.isatty():
        print(f"\r{label}: {count}/{total}", end="\n" if count == total else "", file=sys.stderr, flush=True)
    elif count == total or count % 20 == 0:
        print(f"{label}: {count}/{total}", file=sys.stderr, flush=True)


def _kept_path(keep: Path | None, case: Case) -> Path | None:
    """Return the path of a case's result in the folder ``keep``; None without that folder."""
    return None if keep is None else keep / case.session / case.kind.replace(" ", "_") / f"{case.frame}.json"


_instrument: list[str] = []


def _prepare(instrument: str) -> None:
    """Load the instrument in a worker process."""
    import cv2

    cv2.setNumThreads(1)
    prepare(instrument)
    _instrument[:] = [instrument]


def _run(case: Case, config: EstimateConfig) -> tuple[dict[str, Any], dict[str, float]]:
    """Estimate a case in a worker process; return the result as JSON and the features."""
    body = prepare(_instrument[0])
    try:
        result = estimate(
            case.mask, case.camera, case.readings, body, ignore=case.ignore, frame=case.frame, config=config
        )
    except InputError as error:
        return {"status": "failed", "reasons": [str(error)], "seconds": 0.0}, {}
    except Exception as error:  # a defect: counted, so that the other cases are still run
        return {"status": CRASHED, "reasons": [f"crash: {type(error).__name__}: {error}"], "seconds": 0.0}, {}
    features = measure_features(result, case.mask, case.camera, body, config, ignore=case.ignore)
    return result.to_dict(), features


def by_level(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs by their level, in order of appearance, and all of them under ``all``."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(run.case.level, []).append(run)
    if len(groups) > 1:
        groups["all"] = list(runs)
    return groups
