"""Worlds of the covering array (scripts/worlds), drawn and solved by the commands: what failed, what was ok and wrong.

A frame is solved if its pose is in the right mode and the ends of the instrument, in the mean, are within three stated
standard deviations of the truth. It is ok and wrong if its status is ok and they are off by more than the largest of
3 mm, 2 px and three standard deviations. A recording is wrong if more than a fifth of its ok frames are off by more
than 3 mm. Frames in which less than half of the ends is seen do not count; a frame without a pose is a metre off.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import shutil
import sys
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from worlds.folders import Folder, drawn_folder
from worlds.motion import NOMINAL, Kind, instrument_of
from worlds.table import World

from dvrk_cmaes.cli import main
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.geometry import apply, rotation_angle
from dvrk_cmaes.io.atomic import write_json
from measure.accuracy.figures import RIGHT_MODE_DEG

Command = Literal["estimate", "calibrate", "track"]

KINDS: Final[Mapping[Command, Kind]] = {"estimate": "session", "calibrate": "session", "track": "recording"}
"""What each command solves."""

PARAMETERS: Final = (
    *("size", "focal", "lens", "distance", "instrument", "side", "arm", "images_hz", "readings_hz"),
    *("colour", "border", "tools", "level"),
)
WRONG_MM: Final = 3.0
_WRONG_PX: Final = 2.0
_WRONG_STD: Final = 3.0
_WRONG_SHARE: Final = 0.2
_LEAST_SEEN: Final = 0.5
_CLEAR_OVERLAP: Final = 0.01  # by which the truth must overlap the mask more than a pose that is missed
_REFUSED: Final = 2  # exit code
WITHOUT_POSE_MM: Final = 1000.0


@dataclass(frozen=True)
class Failure:
    """A command that ended with an error: its exit code, or "crash", its last line on stderr, and what was run."""

    frame: str
    code: int | str
    error: str
    run: str


@dataclass(frozen=True)
class Scored:
    """A frame: its status, the error of the ends and its stated standard deviation, mm, and of the rotation, deg.

    ``limit_mm`` is the error from which on an ok frame is wrong. ``missed`` tells a pose in the wrong mode that
    overlaps the mask less than the truth does: the search did not find what the mask shows.
    """

    frame: str
    status: str
    error_mm: float
    std_mm: float
    rotation_deg: float
    limit_mm: float
    missed: bool = False

    @property
    def solved(self) -> bool:
        """Whether it is in the right mode and within three standard deviations."""
        return self.rotation_deg < RIGHT_MODE_DEG and self.error_mm <= _WRONG_STD * self.std_mm

    @property
    def ok(self) -> bool:
        """Whether the status is ok."""
        return self.status == "ok"

    @property
    def wrong(self) -> bool:
        """Whether the status is ok, but the ends are too far off."""
        return self.ok and self.error_mm > self.limit_mm


@dataclass(frozen=True)
class Solved:
    """What a command made of a world: its frames, what failed, and seconds of processor time, also of its workers."""

    world: World
    command: Command
    frames: tuple[Scored, ...]
    failures: tuple[Failure, ...]
    seconds: float

    @property
    def recording_wrong(self) -> bool:
        """Whether more than a fifth of the ok frames are off by more than 3 mm; not of frames estimated each alone."""
        if self.command == "estimate":
            return False
        ok = [frame.error_mm > WRONG_MM for frame in self.frames if frame.ok]
        return bool(ok) and float(np.mean(ok)) > _WRONG_SHARE


def worlds_report(
    table: Sequence[World],
    parent: Path,
    *,
    seed: int = 0,
    only: Sequence[Command] = (*KINDS,),
    frames: int | None = None,
) -> dict[str, Any]:
    """Draw worlds into a folder, solve them, and return tables; what is there is not done again.

    ``frames`` is the number of each session and recording, by default 10 and 30.
    """
    found, undrawn = [], []
    for world in table:
        for command in only:
            kind = KINDS[command]
            print(f"world {world.number}: {command}", file=sys.stderr, flush=True)
            try:
                drawn = drawn_folder(
                    parent / f"seed{seed}" / f"{world.number:03d}", world, seed, kind, frames or NOMINAL[kind]
                )
            except DvrkCmaesError as error:
                undrawn.append({"world": world.number, "command": command, "code": "not drawn", "error": str(error)})
                continue
            found.append(solved(drawn, command))
    return tables(found, undrawn)


def solved(drawn: Folder, command: Command) -> Solved:
    """Solve a session or recording by a command; what was found before is read."""
    path = drawn.path.parent / f"{command}-{drawn.frames}.json"
    if not path.exists() or path.stat().st_mtime < (drawn.path / "world.json").stat().st_mtime:
        started = sum(os.times()[:4])
        results, failures = estimated(drawn) if command == "estimate" else solved_whole(drawn, command)
        seconds = sum(os.times()[:4]) - started
        scores = [asdict(frame) for frame in scored(drawn, results)]
        write_json(path, {"frames": scores, "failures": [asdict(each) for each in failures], "seconds": seconds})
    kept = json.loads(path.read_text(encoding="utf-8"))
    return Solved(
        drawn.world,
        command,
        tuple(Scored(**frame) for frame in kept["frames"]),
        tuple(Failure(**failure) for failure in kept["failures"]),
        kept["seconds"],
    )


def scored(drawn: Folder, results: Mapping[str, Mapping[str, Any]]) -> Iterator[Scored]:
    """Compare results by frame, of frames/FRAME.json or rows of tracks.jsonl, with the truth."""
    instrument = instrument_of(drawn.world.instrument)
    for name, truth in drawn.golden().items():
        if truth["visible"] < _LEAST_SEEN:
            continue
        true, pose = np.array(truth["tips_camera_m"]), np.array(truth["T_camera_roll_link"])
        result = results.get(name, {})
        error, std, rotation = WITHOUT_POSE_MM, 0.0, 180.0
        if result.get("camera_from_root") is not None:
            joints = [result["joints"][joint] for joint in instrument.joint_names]
            ends = apply(np.array(result["camera_from_root"]), instrument.ends(joints))
            error = 1e3 * float(np.linalg.norm(ends - true, axis=1).mean())
            std = _stated(result["std"])
            rotation = float(np.degrees(rotation_angle(np.array(result["camera_from_root"]), pose)))
        pixel_mm = 1e3 * float(true[:, 2].mean()) / drawn.world.camera.fx
        limit = max(WRONG_MM, _WRONG_PX * pixel_mm, _WRONG_STD * std)
        overlap = (result.get("quality") or {}).get("iou", 1.0)
        missed = rotation >= RIGHT_MODE_DEG and overlap < truth["overlap"] - _CLEAR_OVERLAP
        yield Scored(name, result.get("status", "failed"), error, std, rotation, limit, missed)


def _stated(std: Mapping[str, Any]) -> float:
    """Return the mean standard deviation of the ends, mm: a result states it for each, a row of tracks.jsonl for all.

    Of an instrument without a pair of jaws such a row does not state it: then it is that of the position.
    """
    ends = std["tip_mm"]
    if ends is None:
        return float(np.linalg.norm(std["translation_mm"]))
    return float(
        np.mean([value for end, value in ends.items() if end != "mean"]) if isinstance(ends, Mapping) else ends
    )


def estimated(drawn: Folder) -> tuple[dict[str, Any], list[Failure]]:
    """Estimate each frame by itself; return the results by frame, and what failed.

    A frame that is refused with the file of readings and its time is estimated with the values of the nearest row.
    """
    results, failures = {}, []
    for name, stamp in drawn.times().items():
        arguments = ["estimate", "--mask", str(drawn.path / "masks" / f"{name}.png"), "--frame", name, "--json"]
        arguments += [
            "--image",
            str(drawn.path / "images" / f"{name}.jpg"),
            "--camera",
            str(drawn.path / "camera.yaml"),
        ]
        arguments += ["--instrument", drawn.world.instrument, "--arm", drawn.world.arm]
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


def solved_whole(
    drawn: Folder, command: Command, *options: str, out: Path | None = None
) -> tuple[dict[str, Any], list[Failure]]:
    """Calibrate a session or follow a recording; return the results by frame, and the failure if it failed.

    ``options`` are further ones of the command. ``out`` is a folder for its files, which are replaced.
    """
    out = drawn.path.parent / f"{command}-{drawn.frames}" if out is None else out
    shutil.rmtree(out, ignore_errors=True)
    arguments = [command, str(drawn.path), "--out", str(out), "--workers", "1", "--json", *options]
    arguments += ["--only", drawn.arm] if drawn.world.tools > 1 else []
    _, failure = run(arguments, "")
    return whole_results(drawn, command, out), [] if failure is None else [failure]


def whole_results(drawn: Folder, command: Command, out: Path) -> dict[str, Any]:
    """Return the results by frame of a session or recording that was solved as a whole, from the files in ``out``."""
    own = written_by(drawn, out)
    if command == "track":
        tracks = own / "tracks.jsonl"
        rows = [json.loads(line) for line in tracks.read_text(encoding="utf-8").splitlines()] if tracks.exists() else []
        return {row["frame"]: row for row in rows}
    files = sorted((own / "frames").glob("*.json"))
    return {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files}


def written_by(drawn: Folder, out: Path) -> Path:
    """Return the folder of the files of the arm that is solved, of a command that wrote to ``out``."""
    return out / drawn.arm if (out / drawn.arm).is_dir() else out


def run(arguments: Sequence[str], frame: str) -> tuple[str, Failure | None]:
    """Run a command line in this process; return its stdout, and the failure if it is one (exit code not 0 or 3)."""
    out, err = io.StringIO(), io.StringIO()
    code: int | str
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(arguments)
        except Exception:  # a defect: counted, so that the other worlds are still solved
            traceback.print_exc()
            code = "crash"
    if code in (0, 3):
        return out.getvalue(), None
    lines = err.getvalue().strip().splitlines() or ["(nothing on stderr)"]
    return out.getvalue(), Failure(frame, code, lines[-1], shlex.join(["dvrk-cmaes", *arguments]))


def tables(found: Sequence[Solved], undrawn: Sequence[Mapping[str, Any]] = ()) -> dict[str, Any]:
    """Return the tables of a report: figures of each command, of each value, worlds, what failed, what was wrong."""
    commands = list(dict.fromkeys(each.command for each in found))
    by_command = {command: [each for each in found if each.command == command] for command in commands}
    report: dict[str, Any] = {"all": [{"command": command, **figures(own)} for command, own in by_command.items()]}
    for command, own in by_command.items():
        report[f"{command}, by value"] = [
            {"parameter": name, "value": value, **figures(which)}
            for name in PARAMETERS
            for value, which in _by_value(own, name).items()
        ]
        report[f"{command}, by world"] = [{**each.world.describe(), **figures([each])} for each in own]
    report["failed"] = [
        *undrawn,
        *(
            {"world": each.world.number, "command": each.command, **asdict(failure)}
            for each in found
            for failure in each.failures
        ),
    ]
    report["ok and wrong"] = [
        {"world": each.world.number, "command": each.command, **asdict(frame)}
        for each in found
        for frame in each.frames
        if frame.wrong
    ]
    return report


def _by_value(found: Sequence[Solved], name: str) -> dict[Any, list[Solved]]:
    """Group solved worlds by their value of a parameter, in order of the values."""
    groups: dict[Any, list[Solved]] = {}
    for each in sorted(found, key=lambda each: getattr(each.world, name)):
        groups.setdefault(each.world.describe()[name], []).append(each)
    return groups


def figures(found: Sequence[Solved]) -> dict[str, Any]:
    """Return the figures of some worlds that one command solved."""
    frames = [frame for each in found for frame in each.frames]
    ok = [frame for frame in frames if frame.ok]
    errors = [frame.error_mm for frame in frames]
    return {
        "worlds": len(found),
        "failed": sum(bool(each.failures) for each in found),
        "frames": len(frames),
        "solved": _share([frame.solved for frame in frames]),
        "right mode": _share([frame.rotation_deg < RIGHT_MODE_DEG for frame in frames]),
        "missed": sum(frame.missed for frame in frames),
        "ok": _share([frame.ok for frame in frames]),
        "ok and wrong": sum(frame.wrong for frame in frames),
        "recordings wrong": sum(each.recording_wrong for each in found),
        "ends, mm": float(np.median(errors)) if errors else None,
        "worst ok, mm": max((frame.error_mm for frame in ok), default=None),
        "processor seconds": sum(each.seconds for each in found),
    }


def _share(which: Sequence[bool]) -> float | None:
    """Return the share of values that are true; None without any."""
    return float(np.mean(which)) if which else None
