"""What a file or folder is, and what is read of it, by the readers that the commands use.

Formats are distinguished by suffix, first bytes and fields.
"""

from __future__ import annotations

import math
import re
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.camera.document import is_camera, unwrapped
from dvrk_cmaes.camera.fields import WRONG, Side
from dvrk_cmaes.camera.files import read_intrinsics
from dvrk_cmaes.camera.rig import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.coco_mask import FILES, frames_of
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.images import MOST_LABELS, THRESHOLD, looks_like_mask, read_ignore, read_image, read_mask
from dvrk_cmaes.frames.keypoints import read_boxes, read_keypoints
from dvrk_cmaes.frames.label import named
from dvrk_cmaes.frames.markers import read_detections
from dvrk_cmaes.frames.published_layout import is_published_layout
from dvrk_cmaes.frames.session_folder import WARNED, Session, read_session
from dvrk_cmaes.frames.session_toml import ToolEntry, read_session_toml
from dvrk_cmaes.frames.truth import read_golden
from dvrk_cmaes.frames.video_frames import SUFFIXES, Video
from dvrk_cmaes.io.csv_file import separator_of
from dvrk_cmaes.io.files import check_file
from dvrk_cmaes.io.image_header import PNG
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.io.short_text import counted, is_number, listed
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.joint_state import POSITION
from dvrk_cmaes.joints.names import shown_unit
from dvrk_cmaes.joints.reading import TIME_TOLERANCE, read_joint_file
from dvrk_cmaes.joints.rows import BY_THEMSELVES, NO_TIME, ReadAs
from dvrk_cmaes.joints.times import read_image_times
from dvrk_cmaes.recording.lerobot import is_lerobot
from dvrk_cmaes.recording.topics import is_bag
from dvrk_cmaes.results.folder import is_followed, read_result, read_results

_PICTURES: Final = (".png", ".jpg", ".jpeg")
_EXPECTED = "a file or folder to look at"
_KNOWN = "a camera file, joint readings, a mask, an image, a URDF, or a JSON document of a known kind"
_START = 65536  # bytes read to recognise the format
_ROOT = re.compile(rb"<\s*(?!\?|!)([\w:.-]+)")
_LABEL_RULES = {
    "frame": "a frame's readings are found by its name",
    "number": "a frame's readings are found by the number that its name ends in",
    "message": "a frame's readings are found by the image's time",
}
_DESCRIPTIONS = ("readings: ", "camera: ")
_FOLLOWED, _CALIBRATED = 12, 3  # least numbers of frames that are followed, and that are calibrated
_CONSECUTIVE = 0.25  # s, between images that are taken for consecutive ones
_BOTH_EYES = 2.2  # width by height of a video, from which on it is likely to show both eyes beside each other
_STACKED = 0.9  # the same, below which they are likely to be above each other


@dataclass(frozen=True)
class Finding:
    """Result of the inspection of one file or folder.

    Parameters
    ----------
    kind
        Name of the recognised format.
    lines
        The content as text, in mm and degrees.
    read
        The content as plain values for JSON, in m and rad.
    notes
        The rules applied where the content is ambiguous.
    problems
        Files or frames in it that the commands would refuse, each with the reason.
    """

    kind: str
    lines: tuple[str, ...]
    read: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain values for JSON."""
        return {
            "kind": self.kind,
            "in_words": list(self.lines),
            "read": self.read,
            "notes": list(self.notes),
            "problems": list(self.problems),
        }


@dataclass(frozen=True)
class Options:
    """Options for reading ambiguous files, with the meaning of the same options of the other commands."""

    rectified: bool = False
    side: Side = "left"
    package_paths: Mapping[str, Path] = field(default_factory=dict)
    camera: Path | None = None
    read_as: ReadAs = BY_THEMSELVES


def inspect_path(path: str | Path, options: Options | None = None) -> Finding:
    """Recognise the format of a file or folder and describe its content.

    Raises
    ------
    InputError
        The path does not exist, or the file is of no known format or not valid (with the message of its reader).
    """
    settings = Options() if options is None else options
    file = Path(path)
    try:
        if file.is_dir():
            return _inspect_bag(file) if is_bag(file) else _inspect_folder(file, settings)
        check_file(file, expected=_EXPECTED)
        with file.open("rb") as stream:
            start = stream.read(_START)
    except OSError as error:
        raise InputError(f"{path}: not readable ({error.strerror}); expected {_EXPECTED}") from None
    if is_bag(file):
        return _inspect_bag(file)
    suffix = file.suffix.lower()
    if suffix in SUFFIXES:
        return _inspect_video(file)
    if start.startswith((PNG, b"\xff\xd8")):
        return _inspect_picture(file)
    if start.startswith(b"\x93NUMPY"):
        return _inspect_joints(file, settings)
    if b"\0" in start or not start:
        raise InputError(f"{path}: expected {_KNOWN}, got {'something else' if start else 'an empty file'}")
    return _inspect_text(file, start.removeprefix(b"\xef\xbb\xbf").lstrip(), settings)


def _inspect_text(path: Path, start: bytes, options: Options) -> Finding:
    """Recognise the format of a text file and describe it; ``start`` is the beginning of the file."""
    root = _ROOT.match(start) if not start.startswith(b"<?") else _ROOT.search(start)
    if root is not None and root[1] == b"robot":
        return _inspect_urdf(path, options)
    if start.startswith((b"{", b"/*", b"//")):
        return _inspect_json(path, options)
    text = start.decode("utf-8", errors="replace")
    if POSITION.search(text):
        return _inspect_joints(path, options)
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    separator = separator_of(lines[0]) if lines else ","
    names = [name.strip() for name in lines[0].split(separator)] if lines else []
    header = set(names) if separator != " " or all(map(is_number, names)) else set()
    if len(header) > 1 and ":" not in lines[0]:
        return _inspect_table(path, header, options)
    return _inspect_camera(path, options)


def _inspect_table(path: Path, header: set[str], options: Options) -> Finding:
    """Describe a table by the names of its columns."""
    readers: tuple[tuple[set[str], str, Callable[[Path], Mapping[str, Any]]], ...] = (
        ({"tip_1_u"}, "jaw tips", read_keypoints),
        ({"marker"}, "marker detections", read_detections),
        ({"x0"}, "boxes", read_boxes),
    )
    if header == {"frame", "time"}:
        readers = (({"frame"}, "image times", read_image_times),)
    for columns, kind, read in readers:
        if columns <= header:
            found = read(path)
            return Finding(kind, (f"{counted(len(found), 'frame')}: {listed(found)}",), {"frames": list(found)})
    return _inspect_joints(path, options)


def _inspect_json(path: Path, options: Options) -> Finding:
    """Describe a JSON document by the reader that its fields call for; InputError if it is of none."""
    from dvrk_cmaes.calibration.document import read_calibration  # takes long to import, as `load_instrument`

    document = read_json_object(path, expected="a JSON document", comments=True)
    fields = document.keys()
    storage = any(isinstance(value, dict) and "type_id" in value for value in document.values())
    if storage or is_camera(unwrapped(document)):
        return _inspect_camera(path, options)
    if "camera_from_root" in fields:
        result = read_result(path)
        line = f"frame {result.frame or '(unnamed)'}, {result.status}, {result.instrument or 'unnamed instrument'}"
        return Finding("result", (line, *result.reasons), {"frame": result.frame, "status": result.status})
    if "rcm" in fields:
        found = read_calibration(path)
        base = ", ".join(f"{1e3 * value:.2f}" for value in found.rcm)
        lines = [f"{found.status}, of {counted(len(found.frames), 'frame')}; arm's base (RCM) in the camera {base} mm"]
        lines += (f"offset of {_range_text(name, value, value)}" for name, value in found.offsets.items())
        read = {"status": found.status, "offsets": found.offsets}
        return Finding("session calibration (session.json)", (*lines, *found.warnings), read)
    if {"images", "annotations"} <= fields:
        names = list(frames_of(path))
        return Finding("masks of a data set", (f"{counted(len(names), 'frame')}: {listed(names)}",), {"frames": names})
    if fields & {"counts", "segmentation", "shapes"}:
        mask = read_mask(path)
        return Finding("mask", (f"{mask.shape[1]} x {mask.shape[0]} px, {mask.mean():.2%} instrument",))
    if isinstance(document.get("frames"), dict):
        names = list(read_golden(path).frames)
        line = f"{counted(len(names), 'frame')}: {listed(names)}"
        return Finding("known poses (golden.json)", (line,), {"frames": names})
    raise InputError(
        f"{path}: expected a camera, a mask, a result, a session or golden.json, got the "
        f"fields {listed(document) or '(none)'}"
    )


# tables and cameras


def _inspect_joints(path: Path, options: Options) -> Finding:
    """Describe a file of joint readings of any format; InputError if it is not valid."""
    file = read_joint_file(path, read_as=options.read_as)
    for wrong in file.wrong.values():
        raise InputError(wrong)
    count, times = len(file.values), file.times[file.times != NO_TIME].tolist()
    ranges = {
        name: (float(np.nanmin(column)), float(np.nanmax(column)))
        for name, column in zip(file.joints, file.values.T, strict=True)
        if not np.isnan(column).all()
    }
    lines = [
        f"{file.kind}: {counted(count, 'row')}, in rad (insertion: m)",
        *(_range_text(name, *pair) for name, pair in ranges.items()),
    ]
    notes = list(file.notes)
    span = (min(times), max(times)) if times else None
    if span is not None:
        lines.append(f"times from {span[0] / NANOSECONDS:.3f} to {span[1] / NANOSECONDS:.3f} s")
        if span[1] > span[0]:
            lines[-1] += f", {(len(times) - 1) / (span[1] - span[0]) * NANOSECONDS:.1f} rows a second"
        notes.append(
            f"readings are interpolated to an image's time, from at most {TIME_TOLERANCE / NANOSECONDS:g} s away"
        )
    if count > 1:
        notes.append(_LABEL_RULES[file.labels])
    read: dict[str, Any] = {
        "form": file.kind,
        "rows": count,
        "found_by": file.labels,
        "ranges": ranges,
        "time_ns": span,
    }
    if count == 1:
        read["readings"] = file.readings(0)
    return Finding("joint readings", tuple(lines), read, tuple(notes))


def _range_text(name: str, low: float, high: float) -> str:
    """Format the range of a joint, in mm or degrees."""
    scale, unit = shown_unit(name)
    if unit == "deg" and name != "roll" and max(-low, high) > math.pi:
        unit += ": more than half a turn: rad is expected"
    low, high = scale * low, scale * high
    return f"{name} {low:.2f} {unit}" if low == high else f"{name} from {low:.2f} to {high:.2f} {unit}"


def _inspect_camera(path: Path, options: Options) -> Finding:
    """Describe a camera file; InputError if it is not valid."""
    intrinsics = read_intrinsics(path, rectified=options.rectified, side=options.side)
    notes = list(intrinsics.notes)
    remarks: tuple[str, ...] = ()
    distorted = intrinsics.model == "equidistant" or any(intrinsics.distortion)
    if intrinsics.size is None:
        size = "image size not stated"
        notes.append("without a stated image size, that of the masks or images is taken")
    else:
        size = f"{intrinsics.size[0]} x {intrinsics.size[1]} px"
        remarks = intrinsics.camera(path, intrinsics.size).remarks
    if not options.rectified and "ROS" in intrinsics.kind:
        notes.append("images are taken for raw ones unless --rectified says otherwise")
    if "stereo" in intrinsics.kind or "camchain" in intrinsics.kind:
        notes.append("the left camera is taken unless --side says otherwise")
    lens = f"{intrinsics.model} {' '.join(f'{c:.6g}' for c in intrinsics.distortion)}" if distorted else "no distortion"
    read = asdict(intrinsics)
    del read["kind"], read["notes"], read["ratio"]
    return Finding(
        "camera",
        (
            intrinsics.kind,
            f"{size}, focal lengths {intrinsics.fx:.3f} and {intrinsics.fy:.3f} px, "
            f"principal point {intrinsics.cx:.3f}, {intrinsics.cy:.3f}",
            lens,
            *(remark for remark in remarks if not remark.startswith(WRONG)),
        ),
        {"form": intrinsics.kind, **read, "remarks": list(remarks)},
        tuple(notes),
        tuple(f"{path}: {remark}" for remark in remarks if remark.startswith(WRONG)),
    )


# pictures


def _inspect_picture(path: Path) -> Finding:
    """Describe a PNG or JPEG as image, mask, mask of labels or ignored pixels; InputError if it is not valid."""
    pixels = read_image(path)
    height, width = pixels.shape[:2]
    read = {"width": width, "height": height}
    size = f"{width} x {height} px"
    grey = pixels[:, :, 0]
    if not (np.array_equal(grey, pixels[:, :, 1]) and np.array_equal(grey, pixels[:, :, 2])):
        if looks_like_mask(pixels):
            rule = "few colours: labels; --label '#...' says which is the instrument, or label in session.toml"
            return Finding("mask of labels", (f"{size}, the colours {named(pixels)}",), read, (rule,))
        return Finding("image", (_next_of("estimate", "--image", path, beside=path), f"{size}, in colour"), read)
    if path.parent.name == "ignore":
        share = float(read_ignore(path).mean())
        notes = ("it lies in a folder called ignore: above 127 counts neither way",)
        return Finding("ignored pixels", (f"{size}, {share:.2%} ignored",), {**read, "ignored": share}, notes)
    labels, counts = np.unique(grey, return_counts=True)
    if labels.max() <= THRESHOLD and len(labels) <= MOST_LABELS:
        shares = {str(label): float(count / grey.size) for label, count in zip(labels, counts, strict=True)}
        text = ", ".join(f"{label}: {share:.2%}" for label, share in shares.items())
        rule = f"no value is above {THRESHOLD} and few differ: labels; --label says which is the instrument"
        return Finding("mask of labels", (f"{size}, shares of the labels {text}",), {**read, "labels": shares}, (rule,))
    if not looks_like_mask(pixels):
        rule = "grey with many values between: an image, not a mask"
        return Finding("image", (_next_of("estimate", "--image", path, beside=path), f"{size}, grey"), read, (rule,))
    mask = read_mask(path)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    within = f"within columns {columns[0]} to {columns[-1]} and rows {rows[0]} to {rows[-1]}"
    box = [int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])]
    return Finding(
        "mask",
        (_next_of("estimate", "--mask", path, beside=path), f"{size}, {mask.mean():.2%} instrument, {within}"),
        {**read, "instrument": float(mask.mean()), "box": box},
        (f"almost all pixels are near 0 or 255: a mask; above {THRESHOLD} is instrument",),
    )


# instruments and settings


def _inspect_urdf(path: Path, options: Options) -> Finding:
    """Describe an instrument; InputError if it cannot be loaded."""
    from dvrk_cmaes.instrument import load_instrument

    instrument = load_instrument(path, package_paths=options.package_paths)
    shaft, faces = instrument.shaft, {link.name: len(link.faces) for link in instrument.links}
    limits = dict(zip(instrument.joint_names, instrument.limits.tolist(), strict=True))
    lines = (
        f"{instrument.name}, pose sought of {instrument.root_link}",
        f"links with meshes: {', '.join(f'{name} ({count} triangles)' for name, count in faces.items())}",
        f"limits: {', '.join(_range_text(name, *pair) for name, pair in limits.items()) or 'no joints'}",
        "no straight shaft found"
        if shaft is None
        else f"shaft of {1e3 * shaft.radius:.2f} mm radius, straight over {1e3 * shaft.length:.0f} mm",
        "a pair of jaws" if instrument.jaw_tips else "no pair of jaws",
        f"{'looks' if instrument.has_twin else 'does not look'} alike in its mirror twin",
    )
    read = {"name": instrument.name, "root_link": instrument.root_link, "triangles": faces, "limits": limits}
    return Finding("instrument (URDF)", lines, read, ("limits are the URDF's unless --tool gives others",))


# recordings and folders


def _next_command(*words: object) -> str:
    """Say which command to type next."""
    return f"next: dvrk-cmaes {shlex.join(map(str, words))}"


def _next_of(*words: object, beside: Path) -> str:
    """Say which command to type next of pictures, with the camera and the readings that are in folders of theirs."""
    for option, name in (("--camera", "camera.yaml"), ("--joints", "joints.csv")):
        there = [file for folder in (beside.parent, beside.parent.parent) if (file := folder / name).is_file()]
        words += (option, there[0]) if there else (option, name) if name == "camera.yaml" else ()
    return _next_command(*words)


def _inspect_bag(path: Path) -> Finding:
    """Describe the topics of a ROS recording."""
    from dvrk_cmaes.recording.bag import list_topics

    seconds, topics = list_topics(path)
    lines = [_next_command("import", path, "--out", "session"), f"{seconds:.3f} s, {len(topics)} topics"]
    lines += [f"{name}: {kind}, {count} messages, {rate:.1f} a second" for name, (kind, count, rate) in topics.items()]
    read = {"seconds": seconds, "topics": {n: {"type": kind, "messages": k} for n, (kind, k, _) in topics.items()}}
    return Finding("ROS recording", tuple(lines), read)


def _inspect_video(path: Path) -> Finding:
    """Describe a video by its size, its images and its rate; InputError if it cannot be decoded."""
    video = Video(path)
    (width, height), count = video.size, len(video.times)
    seconds = (video.times[-1] - video.times[0]) / NANOSECONDS
    rate = (count - 1) / seconds if seconds else None
    lines = [f"{width} x {height} px, {counted(count, 'image')}" + (f", {rate:.2f} a second" if rate else "")]
    lines.append("clock: its images are counted from 0 s on; --video-start is that of the first on the readings' clock")
    notes = []
    if width >= _BOTH_EYES * height or width < _STACKED * height:
        layout = "side-by-side" if width > height else "top-bottom"
        notes.append(f"of this shape it may show both eyes: then give --layout {layout}")
    folder = path.parent
    own = [folder / name for name in ("camera.yaml", "joints.csv")]
    missing = [file.name for file in own if not file.is_file()]
    places = [folder / name for name in ("masks", "labels") if (folder / name).is_dir()]
    places += [file for file in folder.glob("*mask*") if file.suffix.lower() in SUFFIXES and file != path]
    masks = ("--masks", places[0]) if places else ()
    if missing or masks:
        camera, joints = (file.name if file.name in missing else file for file in own)
        words = ("import", path, "--camera", camera, "--joints", joints, *masks, "--out", "session")
        lines[:0] = [_next_command(*words), *([f"needed, and not beside it: {', '.join(missing)}"] if missing else [])]
    else:
        lines.insert(0, f"taken for a recording, beside camera.yaml and joints.csv; {_next_command('track', path)}")
    read = {"width": width, "height": height, "images": count, "rate": rate}
    return Finding("video", tuple(lines), read, tuple(notes))


def _inspect_folder(path: Path, options: Options) -> Finding:
    """Describe a folder, recognised by the names in it, as results, a data set, pictures or a session."""
    if (path / "frames").is_dir() or is_followed(path):
        return _inspect_results(path)
    if is_lerobot(path):
        words = ("import", path, "--episode", 0, "--camera", "camera.yaml", "--out", "session")
        return Finding("LeRobot data set", (_next_command(*words), "no camera file: --camera is needed"))
    pictures = [p for p in sorted(path.iterdir()) if p.suffix.lower() in _PICTURES and not p.name.startswith(".")]
    others = re.compile(r"^video\.mp4$|mask", re.IGNORECASE)  # of a session, and of masks
    videos = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and not others.search(file.name)]
    if len(videos) == 1 and not pictures and not (path / "images").exists():
        return _inspect_video(videos[0])
    subfolders = any((path / name).exists() for name in ("masks", "images", "session.toml", "camera.yaml", *FILES))
    if pictures and not subfolders and not is_published_layout(path):
        return _inspect_pictures(path, pictures)
    return _inspect_session(path, options)


def _inspect_pictures(path: Path, pictures: Sequence[Path]) -> Finding:
    """Describe a folder of masks or images by what each of its pictures is; other files in it are skipped."""
    kinds: Counter[str] = Counter()
    problems = []
    for picture in pictures:
        try:
            finding = _inspect_picture(picture)
        except InputError as error:
            problems.append(str(error))
            continue
        kinds[f"{finding.kind}, {finding.read['width']} x {finding.read['height']} px"] += 1
    skipped = sorted({file.name for file in path.iterdir()} - {picture.name for picture in pictures})
    lines = (
        _next_of("batch", path, beside=path),
        f"{counted(len(pictures), 'picture')}: {listed(picture.stem for picture in pictures)}",
        *(f"{number} of {len(pictures)}: {kind}" for kind, number in kinds.most_common()),
        *([f"skipped: {listed(skipped)}"] if skipped else []),
    )
    read = {"pictures": [picture.stem for picture in pictures], "kinds": dict(kinds), "skipped": skipped}
    return Finding("folder of pictures", lines, read, (), tuple(problems))


def _inspect_session(path: Path, options: Options) -> Finding:
    """Describe a session folder; of several arms, what each of them sees and reads."""
    findings: dict[str, Finding] = {}
    tools = read_session_toml(path).tools or (ToolEntry(""),)
    read_by = {name: getattr(options, name) for name in ("camera", "rectified", "side", "read_as")}
    for tool in tools:
        session = read_session(path, arm=tool.arm or None, **read_by)
        finding = _of_arm(session, tool.instrument)
        if len(tools) == 1:
            return finding
        findings[tool.arm] = finding
    lines = tuple(f"{arm}: {line}" for arm, finding in findings.items() for line in finding.lines)
    read = {"arms": {arm: finding.read for arm, finding in findings.items()}}
    notes = dict.fromkeys(note for finding in findings.values() for note in finding.notes)
    problems = dict.fromkeys(problem for finding in findings.values() for problem in finding.problems)
    return Finding(f"session of {len(findings)} arms", lines, read, tuple(notes), tuple(problems))


def _of_arm(session: Session, instrument: str | None) -> Finding:
    """Describe a session of one arm, with the instrument that session.toml names."""
    frames = session.frames
    with ThreadPoolExecutor() as threads:
        opened = [*threads.map(partial(_opened, camera=session.rig), frames)]
    problems = {frame.name: found for frame, found in zip(frames, opened, strict=True) if isinstance(found, str)}
    parts = {
        "masks": sum(frame.mask is not None for frame in frames),
        "images": sum(frame.image is not None for frame in frames),
        "readings": sum(bool(frame.readings) for frame in frames),
        "ignored pixels": sum(frame.ignore is not None for frame in frames),
        "jaw tips": sum(frame.keypoints is not None for frame in frames),
        "truth": len(session.truth.frames),
    }
    wrong = [f"{session.folder}: {remark}" for remark in session.rig.remarks if remark.startswith(WRONG)]
    camera, joints = session.camera, dict.fromkeys(name for frame in frames for name in frame.readings)
    lines = [
        _next(session),
        *(remark for remark in session.rig.remarks if not remark.startswith(WRONG)),
        *session.warnings,
        f"{counted(len(frames), 'frame')}: {listed(frame.name for frame in frames)}",
        f"of these with {', '.join(f'{name} {count}' for name, count in parts.items())}",
        *([f"joints read, in rad (insertion: m): {', '.join(joints)}"] if joints else []),
        *(note for note in session.notes if note.startswith(_DESCRIPTIONS)),
        f"camera {camera.width} x {camera.height} px, focal lengths {camera.fx:.3f} and {camera.fy:.3f} px",
        f"instrument {instrument or 'lnd, assumed: session.toml names none (--instrument)'}",
        *_clock(session),
    ]
    found = (note for notes in opened if not isinstance(notes, str) for note in notes)
    other = ("a session folder", *_DESCRIPTIONS, *WARNED)
    rules = dict.fromkeys(note for note in (*session.notes, *found) if not note.startswith(other))
    read = {
        "frames": [frame.name for frame in frames],
        "counts": parts,
        "problems": problems,
        "remarks": session.rig.remarks,
    }
    return Finding("session", tuple(lines), read, tuple(rules), (*problems.values(), *wrong))


def _opened(frame: FrameFiles, camera: Rig) -> str | tuple[str, ...]:
    """Say why a frame's masks and images are refused, such as an empty mask; notes if they are read. Videos are not."""
    if frame.video is not None:
        return frame.problem or frame.notes
    try:
        notes = read_frame(frame, camera).notes
        given = None if frame.label is not None or frame.mask is None or frame.mask.suffix == ".json" else frame.mask
        soft = given is not None and _inspect_picture(given).kind == "image"
        return (*notes, f"masks have many values between 0 and 255: above {THRESHOLD} is instrument") if soft else notes
    except InputError as error:
        return str(error)


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
        return f"taken for a recording of consecutive frames; {_next_command('track', session.folder)}"
    if read >= _CALIBRATED:
        return f"taken for frames of one arm and one camera; {_next_command('calibrate', session.folder)}"
    return f"taken for single frames; {_next_command('batch', session.folder)}"


def _inspect_results(path: Path) -> Finding:
    """Describe a folder of results."""
    results = read_results(path)
    statuses = Counter(result.status for result in results.frames.values())
    counts = ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
    line = f"{counted(len(results.frames), 'frame')} ({counts}): {listed(results.frames)}"
    session = "with a session calibration" if results.session is not None else "each frame by itself"
    if is_followed(path):
        session = "a recording that track followed (tracks.jsonl); lost frames are doubtful, or failed without a pose"
    return Finding("results", (line, session), {"statuses": dict(statuses), "frames": list(results.frames)})
