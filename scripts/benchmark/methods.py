"""Methods that are compared: the commands of this program, PnP from markers, and a particle filter."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from measure.accuracy.worlds import Failure, estimated, solved_whole, whole_results, written_by
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from worlds.motion import instrument_of

from benchmark.particles import follow
from benchmark.submission import JOINTS, Row, read_submission, write_submission
from benchmark.tasks import BASE, Given, TaskName, readings_of
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.pnp.frame import pose_from_markers
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.markers import read_detections, read_marker_table
from dvrk_cmaes.geometry import transform
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.atomic import write_json
from dvrk_cmaes.io.bundled import bundled_path

Float64 = NDArray[np.float64]
_SIGNALLED: Final = 128  # exit codes above are those of commands that a signal ended
Method = Callable[[Given, Path], Iterator[Row]]
"""Solves what is given, with a folder for its files, and yields a row for each frame that has an answer."""


def solved(method: str, given: Given, out: Path) -> dict[str, Row]:
    """Solve a task of a world by a method; return a row for each frame, failed where there is no answer.

    The rows are kept in the folder ``out``, and read from there if they are later than what was given.
    """
    path = out / f"{method}-{given.task}-{given.given.frames}.csv"
    if not path.exists() or path.stat().st_mtime < given.given.path.stat().st_mtime:
        started = sum(os.times()[:4])
        found = {row.frame: row for row in METHODS[method][1](given, out)}
        seconds = (sum(os.times()[:4]) - started) / len(given.frames)
        missing = [Row(given.task, given.world.number, name, "failed") for name in given.frames if name not in found]
        rows = [*found.values(), *missing]
        write_submission(path, [replace(row, seconds=row.seconds or seconds) for row in rows])
    return {row.frame: row for row in read_submission(path).values()}


def _estimate(given: Given, _: Path) -> Iterator[Row]:
    """Estimate each frame by itself."""
    results, failures = estimated(given.given)
    _tell(given, failures)
    for name, result in results.items():
        yield _row(given, name, result)


def _calibrate(given: Given, out: Path) -> Iterator[Row]:
    """Calibrate a session, once for its frames and its base, and that of both eyes."""
    folder = out / f"calibrate-{given.given.path.name}"
    spent = folder / "processor_seconds.json"
    if not spent.exists() or spent.stat().st_mtime < given.given.path.stat().st_mtime:
        started = sum(os.times()[:4])
        _tell(given, solved_whole(given.given, "calibrate", out=folder)[1])
        write_json(spent, {"seconds": sum(os.times()[:4]) - started})
    seconds = json.loads(spent.read_text(encoding="utf-8"))["seconds"] / len(given.frames)
    document = written_by(given.given, folder) / "session.json"
    if given.task != "base":
        for name, result in whole_results(given.given, "calibrate", folder).items():
            yield replace(_row(given, name, result), seconds=seconds)
    elif document.exists():
        found = json.loads(document.read_text(encoding="utf-8"))
        covariance = np.array(found["covariance"]["matrix"])[:6, :6]
        pose = np.array(found["camera_from_base"])
        yield Row("base", given.world.number, BASE, found["status"], pose, None, None, covariance, seconds)


def _track(given: Given, out: Path, *options: str) -> Iterator[Row]:
    """Follow a recording."""
    evidence = "images" if given.task == "images" else "masks"
    options = ("--evidence", evidence, "--no-video", "--no-page", *options)
    folder = out / f"track{'-causal' if '--causal' in options else ''}-{given.task}"
    results, failures = solved_whole(given.given, "track", *options, out=folder)
    _tell(given, failures)
    for name, result in results.items():
        yield _row(given, name, result)


def _tell(given: Given, failures: Sequence[Failure]) -> None:
    """Print the commands that failed on stderr; their frames count as failed.

    Raises
    ------
    DvrkCmaesError
        A command was ended by a signal, which says nothing about its frames.
    """
    for failure in failures:
        if isinstance(failure.code, int) and failure.code > _SIGNALLED:
            raise DvrkCmaesError(f"world {given.world.number}, {given.task}: interrupted; the same command goes on")
        print(f"world {given.world.number}, {given.task}: {failure.error} (of: {failure.run})", file=sys.stderr)


def _row(given: Given, name: str, result: Mapping[str, Any]) -> Row:
    """Return the row of a result in frames/FRAME.json or in tracks.jsonl."""
    status = result["status"] if result["status"] in ("ok", "doubtful") else "failed"
    row = Row(given.task, given.world.number, name, status)
    if result["camera_from_root"] is None:
        return Row(given.task, given.world.number, name, "failed")
    joints = np.array([result["joints"][joint] for joint in JOINTS])
    covariance, std = (result.get("covariance") or {}).get("matrix"), result.get("std")
    if covariance is not None:
        covariance, std = np.array(covariance), None
    elif std is not None:
        turns = [*std["rotation_deg"], *(std["joints_deg"][joint] for joint in JOINTS)]
        std = np.array([*(1e-3 * np.array(std["translation_mm"])), *np.deg2rad(turns)])
    return Row(*row.key, status, np.array(result["camera_from_root"]), joints, std, covariance)


def _pnp(given: Given, _: Path) -> Iterator[Row]:
    """Find the pose of each frame from its markers; the base is the mean of those of the ok frames."""
    instrument, world = instrument_of(given.world.instrument), given.world
    table = read_marker_table(bundled_path("markers", "lnd.json"))
    seen = read_detections(given.given.path / "markers.csv")
    readings = readings_of(given.given, instrument)
    names = (*OUTER_JOINTS, *instrument.joint_names)
    bases = []
    for number, name in enumerate(given.drawn.names):
        values = np.append(readings.outer[number], readings.joints[number])
        files = FrameFiles(name, None, dict(zip(names, values.tolist(), strict=True)))
        result = pose_from_markers(files, world.camera, instrument, table, seen.get(name, {}), arm=world.arm)
        if given.task == "base":
            bases += [result.camera_from_base] if result.status == "ok" and result.camera_from_base is not None else []
        elif result.camera_from_root is not None:
            yield Row(
                *(given.task, world.number, name, result.status), result.camera_from_root, readings.joints[number]
            )
    if bases:
        turn = Rotation.from_matrix([base[:3, :3] for base in bases]).mean().as_matrix()
        yield Row("base", world.number, BASE, "ok", transform(turn, np.mean([base[:3, 3] for base in bases], axis=0)))


def _particles(given: Given, out: Path) -> Iterator[Row]:
    """Follow a recording by a particle filter that starts at the pose by PnP of the first frame that has one."""
    starts = {row.frame: (row.pose, row.joints) for row in _pnp(given, out) if row.status == "ok"}
    first = next((name for name in given.drawn.names if name in starts), None)
    if first is None:
        return
    pose, _ = starts[first]
    assert pose is not None
    for found in follow(given.given, first, pose):
        yield Row(given.task, given.world.number, found.frame, "ok", found.pose, found.joints, None, found.covariance)


METHODS: Final[Mapping[str, tuple[tuple[TaskName, ...], Method]]] = {
    "estimate": (("frame",), _estimate),
    "calibrate": (("session", "eyes", "base"), _calibrate),
    "track": (("masks", "images"), _track),
    "track-causal": (("masks", "images"), lambda given, out: _track(given, out, "--causal")),
    "pnp": (("frame", "base", "masks"), _pnp),
    "particles": (("masks",), _particles),
}
"""The tasks of each method, and the method."""
OURS: Final = ("estimate", "calibrate", "track", "track-causal")
"""The methods of this program."""
