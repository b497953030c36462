"""Inspection of folders: sessions and results, and recordings, which are recognised by name only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.own_files import OwnFiles
from dvrk_cmaes.frames.published_layout import find_published_frames, is_published_layout
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.frames.session_toml import SESSION_FILE, CameraEntry, ToolEntry, read_session_toml
from dvrk_cmaes.frames.tool_frames import frames_of_tool
from dvrk_cmaes.inspection.finding import VIDEOS, Finding, Options, counted
from dvrk_cmaes.inspection.pictures import inspect_image
from dvrk_cmaes.inspection.recordings import LEROBOT, inspect_lerobot, inspect_video, next_command
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.results.folder import is_followed, read_results

PICTURES = (".png", ".jpg", ".jpeg")

_DESCRIPTIONS = ("readings: ", "camera: ")
_FOLLOWED, _CALIBRATED = 12, 3  # least numbers of frames that are followed, and that are calibrated
_CONSECUTIVE = 0.25  # s, between images that are taken for consecutive ones


def inspect_folder(path: Path, options: Options) -> Finding:
    """Describe a folder, recognised by the names in it; InputError if it is of no known kind."""
    if (path / "masks").is_dir() or (path / "images").is_dir() or (path / SESSION_FILE).is_file():
        return _session(path, options)
    if (path / "frames").is_dir() or is_followed(path):
        return _results(path)
    if (path / "metadata.yaml").is_file():
        return inspect_recording(path)
    if (path / LEROBOT).is_file():
        return inspect_lerobot(path)
    if is_published_layout(path):
        if options.camera is None and not (path / "camera.yaml").exists():
            return _without_camera(path, OwnFiles(path))
        return _session(path, options)
    pictures = [
        file for file in sorted(path.iterdir()) if file.suffix.lower() in PICTURES and not file.name.startswith(".")
    ]
    if pictures:
        return _pictures(path, pictures)
    raise InputError(
        f"{path}: expected a session (masks, images, or frames in the published layout), results (frames) or a ROS 2 "
        f"bag (metadata.yaml), got a folder of {listed(sorted(p.name for p in path.iterdir())) or 'nothing'}"
    )


def _pictures(path: Path, pictures: Sequence[Path]) -> Finding:
    """Describe a folder of masks or images by what each of its pictures is; other files in it are skipped."""
    kinds: Counter[str] = Counter()
    problems = []
    for picture in pictures:
        try:
            finding = inspect_image(picture)
        except InputError as error:
            problems.append(str(error))
            continue
        kinds[f"{finding.kind}, {finding.read['width']} x {finding.read['height']} px"] += 1
    skipped = sorted({file.name for file in path.iterdir()} - {picture.name for picture in pictures})
    lines = (
        f"{counted(len(pictures), 'picture')}: {listed(picture.stem for picture in pictures)}",
        *(f"{number} of {len(pictures)}: {kind}" for kind, number in kinds.most_common()),
        *problems,
        *([f"skipped: {listed(skipped)}"] if skipped else []),
    )
    read = {"pictures": [picture.stem for picture in pictures], "kinds": dict(kinds), "skipped": skipped}
    return Finding("folder of pictures", lines, read, ("the kind of each picture is told by its pixels",))


def inspect_recording(path: Path) -> Finding:
    """Describe a video; a ROS recording by its name, without opening it."""
    if path.suffix.lower() in VIDEOS:
        return inspect_video(path)
    return Finding("ROS bag", ("told by its name only: dvrk-cmaes import reads it",), {})


def _session(path: Path, options: Options) -> Finding:
    """Describe a session folder; of several arms, what each of them sees and reads."""
    entries = read_session_toml(path)
    tools = (ToolEntry(""),) if entries is None or not entries.tools else entries.tools
    said = CameraEntry() if entries is None or options.camera is not None else entries.camera
    findings: dict[str, Finding] = {}
    for tool in tools:
        session = read_session(
            path,
            camera=options.camera or said.file or said.left,
            camera_right=said.right,
            rectified=options.rectified or said.rectified,
            side=options.side,
            joints=() if tool.joints is None else (tool.joints,),
            read_as=replace(options.read_as, arm=tool.arm or None, columns=options.read_as.columns or tool.columns),
            fit=said.fit,
            masks=tool.masks,
        )
        if entries is None or len(tools) < 2:
            return _of_arm(session)
        findings[tool.arm] = _of_arm(frames_of_tool(session, entries, tool.arm))
    lines = tuple(f"{arm}: {line}" for arm, finding in findings.items() for line in finding.lines)
    read = {"arms": {arm: finding.read for arm, finding in findings.items()}}
    notes = dict.fromkeys(note for finding in findings.values() for note in finding.notes)
    return Finding(f"session of {len(findings)} arms", lines, read, tuple(notes))


def _of_arm(session: Session) -> Finding:
    """Describe a session of one arm."""
    frames = session.frames
    problems = {frame.name: frame.problem for frame in frames if frame.problem is not None}
    parts = {
        "masks": sum(frame.mask is not None for frame in frames),
        "images": sum(frame.image is not None for frame in frames),
        "readings": sum(bool(frame.readings) for frame in frames),
        "ignored pixels": sum(frame.ignore is not None for frame in frames),
        "jaw tips": sum(frame.keypoints is not None for frame in frames),
        "truth": len(session.truth.frames),
    }
    camera = session.camera
    lines = [
        f"{counted(len(frames), 'frame')}: {listed(frame.name for frame in frames)}",
        f"of these with {', '.join(f'{name} {count}' for name, count in parts.items())}",
        *(note for note in session.notes if note.startswith(_DESCRIPTIONS)),
        f"camera {camera.width} x {camera.height} px, focal lengths {camera.fx:.3f} and {camera.fy:.3f} px",
        *_clock(session),
        *session.rig.remarks,
        *problems.values(),
        _next(session),
    ]
    rules = [note for note in session.notes if not note.startswith(_DESCRIPTIONS)]
    rules += dict.fromkeys(note for frame in frames for note in frame.notes if note not in session.notes)
    read = {
        "frames": [frame.name for frame in frames],
        "counts": parts,
        "problems": problems,
        "remarks": session.rig.remarks,
    }
    return Finding("session", tuple(lines), read, ("its layout is found by looking", *rules[1:]))


def _clock(session: Session) -> list[str]:
    """Say at which rates images and readings of a session follow each other, and by which clock."""
    series = session.reading_series()
    if series is None or not series.times:
        return ["clock: none that images and readings share; rows belong to frames by their names"]
    begin, end = (choose(times[at] for times in series.times.values()) for choose, at in ((min, 0), (max, -1)))
    rows = max(map(len, series.times.values()))
    if series.unit == "frames":
        return [f"clock: none; {counted(rows, 'row')} of readings, in the order of the frames"]
    images, span = sorted(series.frames.values()), end - begin
    said = [f"{counted(rows, 'row')} of readings in {span:.2f} s"]
    if span > 0:
        said[0] += f", {(rows - 1) / span:.1f} a second"
    if len(images) > 1 and images[-1] > images[0]:
        said.append(f"images {(len(images) - 1) / (images[-1] - images[0]):.1f} a second")
    return [f"clock: {'; '.join(said)}"]


def _next(session: Session) -> str:
    """Say what a session is likely to be, and which command to type next."""
    frames, series = session.frames, session.reading_series()
    read = sum({"yaw", "pitch", "insertion", "roll"} <= {*frame.readings} for frame in frames)
    if len(frames) >= _FOLLOWED and series is not None and series.unit == "s" and 0 < series.interval <= _CONSECUTIVE:
        return f"taken for a recording of consecutive frames; {next_command('track', session.folder)}"
    if read >= _CALIBRATED:
        return f"taken for frames of one arm and one camera; {next_command('calibrate', session.folder)}"
    return f"taken for single frames; {next_command('batch', session.folder)}"


def _without_camera(path: Path, own: OwnFiles) -> Finding:
    """Describe frames in the published layout without a camera file."""
    frames = find_published_frames(path, own)
    lines = (
        f"{counted(len(frames), 'frame')} in the published layout: {listed(frame.name for frame in frames)}",
        "no camera file: --camera is needed",
        *(frame.problem for frame in frames if frame.problem is not None),
    )
    return Finding("session", lines, {"frames": [frame.name for frame in frames]}, ("its layout is found by looking",))


def _results(path: Path) -> Finding:
    """Describe a folder of results."""
    results = read_results(path)
    statuses = Counter(result.status for result in results.frames.values())
    counts = ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
    line = f"{counted(len(results.frames), 'frame')} ({counts}): {listed(results.frames)}"
    session = "with a session calibration" if results.session is not None else "each frame by itself"
    if is_followed(path):
        session = "a recording that track followed (tracks.jsonl); lost frames are doubtful, or failed without a pose"
    return Finding("results", (line, session), {"statuses": dict(statuses), "frames": list(results.frames)})
