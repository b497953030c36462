"""Methods that are compared: the commands of this program, and PnP from markers."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from worlds.folders import Folder
from worlds.motion import instrument_of

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.pnp.frame import pose_from_markers
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.markers import read_detections, read_marker_table
from dvrk_cmaes.geometry import transform
from dvrk_cmaes.instrument.arm import OUTER_JOINTS
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.results.result import POSE_AXES
from measuring.benchmark.submission import STATED, Row, read_submission, write_submission
from measuring.benchmark.tasks import BASE, Given, TaskName, readings_of
from measuring.runner import Command, Failure, Ran, run, solved

Float64 = NDArray[np.float64]
_REFUSED: Final = 2  # exit code
_SIGNALLED: Final = 128  # exit codes above are those of commands that a signal ended
Method = Callable[[Given, Path], Iterator[Row]]
"""Solves what is given, with a folder for its files, and yields a row for each frame that has an answer."""


def rows_of_method(method: str, given: Given, out: Path) -> list[Row]:
    """Solve a task of a world by a method; return a row for each frame, failed where there is no answer.

    The rows are kept in the folder ``out``, and read from there if they are later than what was given.
    """
    path = out / f"{method}-{given.task}-{given.given.frames}.jsonl"
    if not path.exists() or path.stat().st_mtime < given.given.path.stat().st_mtime:
        started = sum(os.times()[:4])
        found = {row.frame: row for row in METHODS[method][1](given, out)}
        seconds = (sum(os.times()[:4]) - started) / len(given.frames)
        missing = [_row(given, name, {"status": "failed"}) for name in given.frames if name not in found]
        rows = [*found.values(), *missing]
        write_submission(path, [replace(row, stated={"seconds": seconds, **row.stated}) for row in rows])
    return [*read_submission(path).values()]


def _estimate(given: Given, _: Path) -> Iterator[Row]:
    """Estimate each frame by itself."""
    results, failures = _estimated(given.given)
    _say(given, failures)
    yield from (_row(given, name, result) for name, result in results.items())


def _estimated(drawn: Folder) -> tuple[dict[str, Any], list[Failure]]:
    """Estimate each frame by itself; return the results by frame, and what failed.

    A frame that is refused with the file of readings and its time is estimated with the values of the nearest row.
    """
    results, failures = {}, []
    for name, stamp in drawn.times().items():
        files = {"--mask": f"masks/{name}.png", "--image": f"images/{name}.jpg", "--camera": "camera.yaml"}
        arguments = ["estimate", "--frame", name, "--json", "--arm", drawn.world.arm]
        arguments += [word for option, file in files.items() for word in (option, str(drawn.path / file))]
        arguments += ["--instrument", drawn.world.instrument]
        ignored = drawn.ignored / f"{name}.png"
        arguments += ["--ignore", str(ignored)] if ignored.exists() else []
        arguments += ["--label", "1"] if drawn.world.tools > 1 else []
        out, failure = run([*arguments, "--joints", str(drawn.path / "joints.csv"), "--time", f"{stamp:.6f}"], name)
        failures += [] if failure is None else [failure]
        if failure is not None and failure.code == _REFUSED:
            values = ",".join(f"{joint}={value:g}" for joint, value in drawn.nearest_readings(stamp).items())
            out, failure = run([*arguments, "--joints", values], name)
            failures += [] if failure is None else [failure]
        if out.startswith("{"):
            results[name] = json.loads(out)
    return results, failures


def _whole(given: Given, command: Command, out: Path, *options: str) -> Ran:
    """Solve a given folder as a whole, once for several tasks."""
    ran = solved(
        given.given.path, command, out, [*options, *(["--only", given.given.arm] if given.world.tools > 1 else [])]
    )
    _say(given, ran.failures)
    return ran


def _calibrate(given: Given, out: Path) -> Iterator[Row]:
    """Calibrate a session, once for its frames and its base, and that of both eyes."""
    ran = _whole(given, "calibrate", out / f"calibrate-{given.given.path.name}")
    seconds = {"seconds": ran.processor / len(given.frames)}
    if given.task != BASE:
        for name, result in ran.documents(given.given.arm).items():
            yield _row(given, name, {**result, **seconds})
    elif (found := ran.document("session.json", given.given.arm)) is not None:
        matrix = np.array(found["covariance"]["matrix"])[:6, :6]
        pose = {"status": found["status"], "camera_from_root": found["camera_from_base"]}
        yield _row(given, BASE, {**pose, "covariance": {"axes": [*POSE_AXES], "matrix": matrix.tolist()}, **seconds})


def _track(given: Given, out: Path, *options: str) -> Iterator[Row]:
    """Follow a recording."""
    evidence = "images" if given.task == "images" else "masks"
    folder = out / f"track{'-causal' if options else ''}-{given.task}"
    ran = _whole(given, "track", folder, "--evidence", evidence, *options)
    yield from (_row(given, name, result) for name, result in ran.documents(given.given.arm).items())


def _say(given: Given, failures: Sequence[Failure]) -> None:
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
    """Return the row of a result in frames/FRAME.json or in tracks.jsonl; frames that were lost have failed."""
    stated = {"status": "failed"} if result["status"] == "lost" else {}
    known = {name: result[name] for name in STATED if result.get(name) is not None}
    return Row(given.task, given.world.number, name, known | stated)


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
        if given.task == BASE:
            bases += [result.camera_from_base] if result.status == "ok" and result.camera_from_base is not None else []
        elif result.camera_from_root is not None:
            read = dict(zip(instrument.joint_names, readings.joints[number].tolist(), strict=True))
            pose = {"status": result.status, "camera_from_root": result.camera_from_root.tolist()}
            yield _row(given, name, {**pose, "joints": read})
    if bases:
        turn = Rotation.from_matrix([base[:3, :3] for base in bases]).mean().as_matrix()
        mean = transform(turn, np.mean([base[:3, 3] for base in bases], axis=0))
        yield _row(given, BASE, {"status": "ok", "camera_from_root": mean.tolist()})


METHODS: Final[Mapping[str, tuple[tuple[TaskName, ...], Method]]] = {
    "estimate": (("frame",), _estimate),
    "calibrate": (("session", "eyes", "base"), _calibrate),
    "track": (("masks", "images"), _track),
    "track-causal": (("masks", "images"), lambda given, out: _track(given, out, "--causal")),
    "pnp": (("frame", "base", "masks"), _pnp),
}
"""The tasks of each method, and the method."""
OURS: Final = ("estimate", "calibrate", "track", "track-causal")
"""The methods of this program."""
